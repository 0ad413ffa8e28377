"""A run does what flags, file and defaults ask for, and refuses what makes no sense."""

import hashlib
import json
import math
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from bristle.meshes.distribute import to_dolfinx
from bristle.meshes.geometry import MeshSpec
from bristle.meshes.section import Circle
from bristle.solver import paper
from bristle.solver.bodies import linear
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import CONTACT_POINTS, Bristle
from bristle.solver.contact.enforcement import Enforcement
from bristle.solver.errors import InputError
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.brush.inputs import BrushInputs
from bristle.studies.cli import MESH_FLAGS, app
from bristle.studies.inputs.brush_fields import BRUSH_FLAGS
from bristle.studies.inputs.choices import Contact, Model, Solver, Until
from bristle.studies.inputs.config import DropInputs, MeshInputs
from bristle.studies.inputs.fields import DROP_FLAGS, LIST_FLAGS, STUDY_FLAGS
from bristle.studies.inputs.kinds import forgotten_afterwards
from bristle.studies.inputs.limits import (
    count_unknowns,
    input_warnings,
    narrow_zone,
    slowest_bending_1_s,
)
from bristle.studies.inputs.named import PluginFile
from bristle.studies.inputs.sources import (
    checked,
    command_line,
    flag_source,
    inputs_of,
    read_config,
)
from bristle.studies.inputs.study_fields import SCATTER_FLAGS, TRACK_FLAGS, LoopInputs, TrackInputs
from bristle.studies.its import ItsInputs
from bristle.studies.running.files import to_json
from bristle.studies.running.results import plain_inputs
from bristle.studies.running.study import StudyInputs
from bristle.studies.scatter.inputs import ScatterInputs

pytestmark = pytest.mark.serial

NUMBERS = {flag.field: flag for flag in DROP_FLAGS if flag.kind in (float, int)}
CONTRACT_FLAGS = (
    "model contact kn height its length width thickness diameter youngs poisson density beta alpha "
    "gravity tilt slope friction tip elements cells order until effect "
    "tilt-wide slope-wide kt-ratio tip-shape contact-points"
)


def drop(**values):
    return checked(DropInputs, values)


def config(tmp_path, text, name="bristle.toml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def from_file(path, given=None):
    return inputs_of(DropInputs, given or {}, DROP_FLAGS, path)


def test_every_flag_of_the_contract_is_there():
    assert set(CONTRACT_FLAGS.split()) <= {flag.name for flag in DROP_FLAGS}
    assert {flag.name for flag in LIST_FLAGS} == {"models", "kn", "heights", "its"}


@pytest.mark.parametrize("flag", DROP_FLAGS, ids=lambda flag: flag.name)
def test_help_tells_the_true_default(flag):
    resolved = getattr(DropInputs(contact="nitsche", scheme="generalised"), flag.field)
    if flag.kind == (int, int, int):
        assert flag.default_text() == " ".join(map(str, resolved))
    first = re.match(r"-?\d[\d.e+-]*", flag.default_text())
    if flag.kind in (float, int) and flag.default_text() and flag.name != "write-every":
        assert float(first.group()) == pytest.approx(resolved, rel=1e-3)


def test_defaults_are_the_papers():
    inputs = DropInputs()
    assert inputs.bristle() == Bristle()
    assert (inputs.kn_N_m, inputs.height_m, inputs.its_s) == (2e6, 0.05, 1e-5)
    assert (inputs.tilt_deg, inputs.slope_deg, inputs.contact) == (0.0, 0.0, "penalty")
    assert inputs.mesh_spec() == MeshSpec()
    assert StudyInputs().kn_N_m == paper.KN_N_M
    assert StudyInputs().heights_m == paper.HEIGHTS_M
    assert len(StudyInputs().cases()) == 2 * len(paper.KN_N_M) * len(paper.HEIGHTS_M)
    assert ItsInputs().heights_m == (0.05,)
    assert inputs.contact_points == CONTACT_POINTS


def test_choices_are_the_solvers():
    assert [member.value for member in Contact] == [member.value for member in Enforcement]
    assert [member.value for member in Solver] == [each.value for each in linear.Solver]


@pytest.mark.parametrize(
    ("values", "option"),
    [
        ({"kn_N_m": 0.0}, "--kn"),
        ({"kn_N_m": 0.01}, "--kn"),
        ({"kn_N_m": 1e15}, "--kn"),
        ({"height_m": -0.05}, "--height"),
        ({"height_m": 0.0}, "--height"),
        ({"height_m": "0.05"}, "--height"),
        ({"height_m": True}, "--height"),
        ({"its_s": 1.0}, "--its"),
        ({"its_s": 1e-11}, "--its"),
        ({"poisson": 0.5}, "--poisson"),
        ({"youngs_Pa": 5000.0}, "--youngs"),
        ({"alpha_1_s": 1e-30}, "--alpha"),
        ({"alpha_1_s": 5e4}, "--alpha"),
        ({"gravity_m_s2": 0.0}, "--gravity"),
        ({"tilt_wide_deg": -81.0}, "--tilt-wide"),
        ({"slope_wide_deg": math.nan}, "--slope-wide"),
        ({"tilt_wide_deg": 60.0, "slope_wide_deg": -25.0}, "--tilt-wide"),
        ({"model": "analytic", "slope_wide_deg": 1.0}, "--slope-wide"),
        ({"model": "analytic", "tip_shape": "worn:angle=1"}, "--tip-shape"),
        ({"friction": -0.1}, "--friction"),
        ({"kt_ratio": 0.0}, "--kt-ratio"),
        ({"contact_points": 34}, "--contact-points"),
        ({"contact_points": 9.0}, "--contact-points"),
        ({"tip_shape": "rounded"}, "--tip-shape"),
        ({"tip_shape": "rounded:radius=1e-3"}, "--tip-shape"),
        ({"tip_shape": "worn:angle=5", "tip": "point"}, "--tip-shape"),
        ({"tip_shape": 5}, "--tip-shape"),
        ({"diameter_m": 1e-3, "thickness_m": 1e-3}, "--thickness"),
        ({"theta": 1}, "--theta"),
        ({"theta": 2, "contact": "nitsche"}, "--theta"),
        ({"gamma0": 10.0}, "--gamma0"),
        ({"rho_inf": 0.5}, "--rho-inf"),
        ({"rho_inf": 1.5, "scheme": "generalised"}, "--rho-inf"),
        ({"scheme": "euler"}, "--scheme"),
        ({"contact": "glue"}, "--contact"),
        ({"model": "reduced", "tip": "point"}, "--tip"),
        ({"model": "solid", "cells": (1, 4)}, "--cells"),
        ({"model": "solid", "cells": (0, 4, 3)}, "--cells"),
        ({"model": "solid", "cells": (1.0, 4, 3)}, "--cells"),
        ({"model": "solid", "cells": (300, 300, 300)}, "--cells"),
        ({"model": "solid", "grading": 1e6}, "--cells"),
        ({"order": 3}, "--order"),
        ({"elements": 0}, "--elements"),
        ({"elements": 100_000}, "--elements"),
        ({"model": "analytic", "contact": "nitsche"}, "--contact"),
        ({"until": 0.05}, "--until"),
        ({"until": 1e9}, "--until"),
        ({"until": True}, "--until"),
        ({"effects": ["wear:rate"]}, "--effect"),
        ({"effects": ["wear:rate=x"]}, "--effect"),
        ({"effects": "wear"}, "--effect"),
    ],
    ids=str,
)
def test_nonsense_is_refused_by_the_name_of_its_option(values, option):
    """More of it stands in test_cli.py."""
    with pytest.raises(InputError, match=f"^{re.escape(option)}: "):
        drop(**values)


def test_a_misspelt_effect_is_told_the_right_name():
    with pytest.raises(InputError, match="did you mean air_drag"):
        drop(effects=["air_dragg:cd=1"])


@given(
    st.dictionaries(
        st.sampled_from(sorted(NUMBERS)),
        st.one_of(st.floats(), st.integers(), st.booleans(), st.text(max_size=4)),
        min_size=1,
        max_size=3,
    )
)
@settings(max_examples=400, deadline=None)
def test_any_number_gives_a_sound_model_or_one_clear_refusal(values):
    try:
        inputs = drop(**values)
    except InputError as error:
        option = str(error).split(":", 1)[0]
        assert option in {flag.option for flag in DROP_FLAGS}
        return
    for field in values:
        value = getattr(inputs, field)
        assert value is None or math.isfinite(value)
    assert inputs.bristle().mass_kg > 0.0
    assert inputs.drop_plan(1).height_m == inputs.height_m


def test_an_infinite_stiffness_is_for_those_who_can_use_it():
    for contact in ("nitsche", "augmented"):
        assert math.isinf(drop(kn_N_m="inf", contact=contact).contact_method().law.kn_N_m)


def test_what_depends_on_other_options_is_resolved():
    nitsche = drop(contact="nitsche")
    assert (nitsche.theta, nitsche.gamma0) == (1, 10.0)
    assert drop(contact="nitsche", kn_N_m="inf").gamma0 == 2.0
    assert DropInputs().theta is None
    wire = drop(diameter_m=1e-3)
    assert (wire.width_m, wire.thickness_m, wire.geometry_order) == (None, None, 2)
    assert wire.mesh_spec().section == Circle(1e-3)
    assert wire.bristle().section == Circle(1e-3)


def test_the_wires_mass_is_that_of_a_cylinder():
    wire = drop(diameter_m=1.2e-3, length_m=0.1, density_kg_m3=7000.0).bristle()
    assert wire.mass_kg == pytest.approx(7000.0 * 0.1 * math.pi * 0.6e-3**2, rel=1e-14)


@pytest.mark.parametrize(
    ("values", "leaning"),
    [
        ({}, False),
        ({"tip": "point", "model": "beam"}, False),
        ({"tilt_deg": 1e-3}, True),
        ({"tilt_wide_deg": -1.0}, True),
        # square to a surface that slopes, it still slides down it
        ({"tilt_deg": 2.0, "slope_deg": 2.0}, True),
        ({"tip_shape": "worn:angle=1"}, True),
    ],
    ids=str,
)
def test_friction_acts_where_something_can_slide(values, leaning):
    inputs = drop(friction=0.3, kt_ratio=0.7, **values)
    assert inputs.leaning is leaning
    friction = inputs.contact_method().friction
    assert (friction.mu, friction.kt_over_kn) == (0.3 if leaning else 0.0, 0.7)
    assert inputs.drop_plan(4).method.friction == friction


def test_the_tangential_stiffness_is_mindlins_unless_given(tmp_path):
    assert drop(poisson=0.3).kt_ratio == pytest.approx(1.4 / 1.7)
    assert drop(poisson=0.3, kt_ratio=0.5).kt_ratio == 0.5
    written = to_json({"inputs": plain_inputs(drop(poisson=0.3))})
    path = config(tmp_path, written, "result.json")
    assert from_file(path, {"poisson": 0.0}).kt_ratio == pytest.approx(1.0)


def test_lean_and_slope_reach_the_solver():
    plan = drop(tilt_deg=3.0, tilt_wide_deg=-1.0, slope_deg=5.0, slope_wide_deg=2.0).drop_plan(4)
    assert (plan.tilt_deg, plan.tilt_wide_deg) == (3.0, -1.0)
    assert plan.ground.normals.shape == (4, 3)
    normal = plan.ground.normals[0]
    assert np.degrees(np.arctan2(normal[:2], normal[2])) == pytest.approx([5.0, 2.0])


@pytest.mark.parametrize(
    ("values", "lean"),
    [
        ({"tilt_deg": 3.0}, 3.0),
        ({"slope_deg": -3.0}, 3.0),
        ({"tilt_deg": 3.0, "slope_deg": -4.0}, 7.0),
        ({"tilt_wide_deg": 3.0, "slope_wide_deg": 3.0}, 0.0),
        ({"tilt_deg": 45.0, "tilt_wide_deg": 45.0}, math.degrees(math.atan(math.sqrt(2.0)))),
    ],
    ids=str,
)
def test_lean_counts_from_the_surfaces_normal(values, lean):
    assert drop(**values).lean_deg == pytest.approx(lean, abs=1e-9)


def test_a_worn_face_stands_back_toward_its_direction_only():
    points, _ = Circle(1e-3).contact_points(9)
    worn = drop(diameter_m=1e-3, tip_shape="worn:angle=5,direction=180")
    # a mesh of a wire, and rounding, put points a little outside
    for places in (points, points * (1.0 + 1e-4)):
        back = worn.face_offsets_m(places)
        assert back.min() == pytest.approx(0.0, abs=1e-15)
        assert back.max() == pytest.approx(1e-3 * math.tan(math.radians(5.0)))
        assert back[np.argmin(places[:, 0])] == back.max()


def test_plans_follow_until():
    assert drop(until="impact").drop_plan(1).impact_only
    rebound = drop(until="rebound").drop_plan(1)
    assert (rebound.until_s, rebound.impact_only) == (None, False)
    assert drop(until="0.3").drop_plan(1).until_s == 0.3
    assert drop(until=Until.IMPACT).until is Until.IMPACT


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"scheme": "average"}, TimeScheme.average()),
        ({"scheme": "newmark"}, TimeScheme.newmark()),
        ({"scheme": "generalised", "rho_inf": 0.3}, TimeScheme.generalised(0.3)),
    ],
    ids=str,
)
def test_schemes_reach_the_solver(values, expected):
    assert drop(**values).drop_plan(1).scheme == expected


def test_the_effective_matrix_of_newmarks_average_acceleration():
    # a = 4/h² Δu and v = 2/h Δu at the end of the step: 4/h² M + 2/h C + K, up to a factor
    h, alpha, beta = 1e-5, 3.0, 2e-6
    shift = (4.0 / h**2 + 2.0 * alpha / h) / (1.0 + 2.0 * beta / h)
    for scheme in (TimeScheme.newmark(), TimeScheme.average()):
        c_mass, c_stiffness = scheme.effective(h, alpha, beta)
        assert c_mass / c_stiffness == pytest.approx(shift, rel=1e-13)


def test_flags_win_over_the_file_and_the_file_over_defaults(tmp_path):
    path = config(tmp_path, 'kn = 1e6\nheight = 0.02\nmodel = "analytic"\ncells = [1, 2, 30]\n')
    inputs = from_file(path, {"kn": 3e6})
    assert (inputs.kn_N_m, inputs.height_m, inputs.its_s) == (3e6, 0.02, paper.ITS_S)
    assert (inputs.model, inputs.cells) == (Model.ANALYTIC, (1, 2, 30))


def test_keys_may_have_dashes_underscores_or_units(tmp_path):
    for key in ("rho_inf", "rho-inf"):
        path = config(tmp_path, f'scheme = "generalised"\n{key} = 0.5\nkn_N_m = 1e6\n')
        assert from_file(path).rho_inf == 0.5


def test_a_flag_takes_what_hangs_on_it_out_of_the_file(tmp_path):
    flat = config(tmp_path, "width = 2e-3\nthickness = 1e-3\n")
    assert from_file(flat, {"diameter": 1e-3}).width_m is None
    nitsche = config(tmp_path, 'contact = "nitsche"\ntheta = 1\n')
    assert from_file(nitsche, {"contact": "penalty"}).theta is None


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("kn = 1e6\n\nheigth = 0.02\n", 3, "heigth: unknown key; did you mean height"),
        ("# kn = 5\nkn = -1e6\n", 2, "kn: must be greater"),
        ('its = 1e-6\nheight = "high"\n', 2, "height: must be a number, not 'high'"),
        ('\n"height" = nan\n', 2, "height: must be a finite number"),
        ("kn = 1e6\nkn = 2e6\n", 2, "not valid TOML"),
        ("kn = 1e6\nheight 0.05\n", 2, "not valid TOML"),
        ("[contact]\nkn = 1e6\n", 1, "contact: must be"),
        ("kn = 1e6\n[[bodies]]\nkn = 1e6\n", 2, "bodies: unknown key"),
        ("height = 0.05\ntilt = 93.0\n", 2, "tilt: must be less than or equal to 80"),
        ("theta = 1\n", 1, "theta: belongs to"),
        ("kn = 1e6\nkn_N_m = 1e6\n", 2, "kn_N_m: given twice"),
        ('effect = [\n  "wear:a=1",\n]\n', 1, "effect: wear has no parameter 'a'"),
    ],
    ids=str,
)
def test_a_wrong_file_is_told_by_file_and_line(tmp_path, text, line, says):
    path = config(tmp_path, text)
    with pytest.raises(InputError) as caught:
        from_file(path)
    assert str(caught.value).startswith(f"{path}:{line}: {says}")


def test_an_unreadable_mesh_is_told_by_its_option_beside_a_material_too(tmp_path):
    file = tmp_path / "none.msh"
    with pytest.raises(InputError, match=re.escape(f"--mesh: {file}")):
        drop(mesh=str(file), material="nylon")


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"model": "solid", "diameter_m": 1e-3, "cells": (2, 1, 9)},
        {"contact": "nitsche", "kn_N_m": math.inf, "theta": -1, "gamma0": 3.0},
        {"scheme": "generalised", "rho_inf": 0.0, "until": 0.4},
        {"until": "impact", "write_every": 7, "write_fields": False},
        {"tilt_deg": 2.0, "slope_wide_deg": -3.0, "poisson": 0.3, "tip_shape": "worn:angle=2"},
    ],
    ids=str,
)
def test_inputs_survive_their_own_file(tmp_path, values):
    inputs = drop(**values)
    path = config(tmp_path, to_json({"inputs": plain_inputs(inputs)}), "result.json")
    assert from_file(path) == inputs


@pytest.mark.parametrize(
    ("text", "says"), [("{", ":1: not valid JSON"), ("[]", ":1: not a result")]
)
def test_a_json_that_is_no_result_is_refused(tmp_path, text, says):
    path = config(tmp_path, text, "result.json")
    with pytest.raises(InputError, match=re.escape(f"{path}{says}")):
        from_file(path)


def test_lists_come_as_text_list_or_alone(tmp_path):
    given = {"models": "beam, analytic", "kn": "1e5,2e6,1e5", "heights": "0.01"}
    inputs = checked(StudyInputs, flag_source(given, STUDY_FLAGS).values)
    cases = [(case.model, case.kn_N_m) for case in inputs.cases()]
    assert cases == [(model, kn) for model in ("analytic", "beam") for kn in (1e5, 2e6)]
    path = config(tmp_path, 'kn = [1e5, 2e6]\nmodel = "beam"\nheight = 0.02\nits = 1e-6\n')
    inputs = inputs_of(StudyInputs, {}, STUDY_FLAGS, path)
    assert (inputs.models, inputs.heights_m, inputs.its_s) == (("beam",), (0.02,), (1e-6,))


@pytest.mark.parametrize(
    ("given", "option"),
    [
        ({"kn": "1e5,,2e6"}, "--kn"),
        ({"kn": "1e5,soft"}, "--kn"),
        ({"kn": "1e5,-1"}, "--kn"),
        ({"kn": "inf"}, "--kn"),
        ({"models": "beam,shell"}, "--models"),
        ({"heights": ""}, "--heights"),
        ({"its": "1e-5,nan"}, "--its"),
    ],
    ids=str,
)
def test_a_wrong_list_is_told_by_its_option(given, option):
    with pytest.raises(InputError, match=f"^{option}: "):
        inputs_of(StudyInputs, given, STUDY_FLAGS, None).cases()


def test_a_mesh_passes_over_what_does_not_concern_it(tmp_path):
    path = config(tmp_path, "kn = 1e6\ncells = [1, 2, 9]\nlength = 0.1\n")
    spec = inputs_of(MeshInputs, {}, MESH_FLAGS, path, ignored=DROP_FLAGS).mesh_spec()
    assert (spec.cells, spec.length_m) == ((1, 2, 9), 0.1)
    with pytest.raises(InputError, match="unknown key"):
        inputs_of(MeshInputs, {}, MESH_FLAGS, config(tmp_path, "knn = 1\n"), ignored=DROP_FLAGS)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("section", [{}, {"diameter_m": 1e-3}], ids=str)
def test_unknowns_are_counted_before_they_are_made(order, section):
    inputs = drop(cells=(2, 3, 4), order=order, **section)
    domain, _, _ = to_dolfinx(inputs.mesh_spec(), MPI.COMM_SELF)
    space = fem.functionspace(domain, ("Lagrange", order, (3,)))
    made = space.dofmap.index_map.size_global * space.dofmap.index_map_bs
    assert count_unknowns(inputs) == made


def test_a_coarse_step_is_warned_of_with_value_limit_and_remedy():
    (warning,) = input_warnings(drop(kn_N_m=1e8))
    assert "1e-05" in warning
    assert "8.21e-06" in warning
    remedy = float(re.search(r"--its (\S+) or less", warning).group(1))
    assert input_warnings(drop(kn_N_m=1e8, its_s=remedy)) == []
    assert input_warnings(DropInputs()) == []


def test_a_strong_lean_and_a_sliding_point_are_warned_of():
    (warning,) = input_warnings(drop(tilt_deg=8.0, slope_deg=-4.0))
    assert "leans by 12 degrees" in warning
    assert "above 10" in warning
    assert input_warnings(drop(tilt_deg=8.0)) == []
    (warning,) = input_warnings(drop(tilt_deg=2.0, tip="point", model="beam"))
    assert warning.startswith("--tip point with --friction 0.5")
    assert "--tip face" in warning
    assert input_warnings(drop(tilt_deg=2.0, tip="point", model="beam", friction=0.0)) == []
    assert input_warnings(drop(tip="point", model="beam")) == []


def test_a_zone_narrower_than_the_points_distance_is_found():
    # 5 µm deep at 20 degrees: 15 µm from the edge; nine Lobatto points leave 25 µm there
    inputs = drop(tilt_deg=20.0)
    width, spacing = narrow_zone(inputs, 5e-6)
    assert width == pytest.approx(5e-6 / math.sin(math.radians(20.0)), rel=1e-9)
    assert spacing == pytest.approx(0.25e-3 * (1.0 - 0.8997579954), rel=1e-6)
    assert narrow_zone(inputs, 10e-6) is None
    assert narrow_zone(inputs, 5e-6, 17) is None
    assert narrow_zone(DropInputs(), 1e-9) is None
    # worn to the lean, the face lies flat
    assert narrow_zone(drop(tilt_deg=20.0, tip_shape="worn:angle=20"), 5e-6) is None
    assert narrow_zone(drop(tilt_deg=-20.0, tip_shape="worn:angle=20"), 5e-6) is not None


def test_the_slowest_bending_is_the_beams():
    beam = beam_body(Bristle(), 16)
    slowest = math.sqrt(beam.omega2[beam.omega2 > 0.0].min())
    assert slowest_bending_1_s(Bristle()) == pytest.approx(slowest, rel=1e-4)


def test_files_are_looked_for_beside_a_toml_file(tmp_path):
    (tmp_path / "own.py").write_text("x = 1\n")
    path = config(tmp_path, 'plugins = ["own.py", "/there.py"]\nmesh = "own.msh"\n')
    source = read_config(path, DROP_FLAGS)
    assert source.values["plugins"] == [str(tmp_path / "own.py"), "/there.py"]
    assert source.values["mesh"] == str(tmp_path / "own.msh")


PLUGIN = (Path(__file__).parents[2] / "docs" / "examples" / "my_effect.py").read_text()


def ran(path):
    """A plugin that leaves a file behind where it is run."""
    path.write_text(f"{PLUGIN}\nopen({str(path.with_suffix('.ran'))!r}, 'w')\n")
    return path


@forgotten_afterwards()
def named_by(config, *plugins):
    return inputs_of(DropInputs, {"plugin": list(map(str, plugins))}, DROP_FLAGS, Path(config))


PAGES = {"scatter": (ScatterInputs, SCATTER_FLAGS), "brush": (BrushInputs, BRUSH_FLAGS)}


@pytest.mark.parametrize("name", PAGES)
def test_the_command_of_a_page_can_be_pasted(tmp_path, name):
    kind, flags = PAGES[name]
    surface = tmp_path / "a map's heights.csv"
    surface.write_text("# spacing_m = 1e-5\n" + "0,1,2,3\n" * 4)
    inputs = checked(kind, {"surface": str(surface), "kn_N_m": 1e5, "friction": 0.1})
    command = command_line(name, inputs, checked(kind, {}), tmp_path)
    _, _, *words = shlex.split(command)
    given = app.commands[name].make_context(name, words).params
    by_flag = {each.parameter: given[each.parameter] for each in flags}
    assert inputs_of(kind, by_flag, flags, None) == inputs


def test_the_command_of_a_page_of_the_loop_names_its_plugins(tmp_path):
    files = [tmp_path / name for name in ("one.py", "a second.py")]
    plugins = tuple(PluginFile(path=str(file), sha256="") for file in files)
    inputs = LoopInputs.model_construct(plugins=plugins)
    words = shlex.split(command_line("close-loop", inputs, LoopInputs(), tmp_path, "data"))
    named = [word for file in files for word in ("--plugin", str(file))]
    assert words == ["bristle", "close-loop", "data", *named, "--out", str(tmp_path)]


def test_the_command_of_a_page_of_films_names_what_was_given(tmp_path):
    ball = {"body": "ball", "diameter_mm": 40, "fps": 120, "roi": (0, 1, 20, 30), "down": "left"}
    inputs = checked(TrackInputs, ball)
    _, *words = shlex.split(command_line("track", inputs, TrackInputs(), tmp_path, "a b.mp4"))
    assert words[:2] == ["track", "a b.mp4"]
    given = app.commands["track"].make_context("track", words[1:]).params
    by_flag = {each.parameter: given[each.parameter] for each in TRACK_FLAGS}
    assert inputs_of(TrackInputs, by_flag, TRACK_FLAGS, None) == inputs


def test_a_plugin_that_a_file_names_runs_only_if_the_command_line_names_it(tmp_path, caplog):
    own, other = ran(tmp_path / "own.py"), ran(tmp_path / "other.py")
    toml = config(tmp_path, 'plugin = "own.py"\neffect = ["my_effect:exponent=-0.5"]\n')
    digest = hashlib.sha256(own.read_bytes()).hexdigest()
    inputs = {"plugins": [{"path": str(own), "sha256": digest}], "model": "beam"}
    result = tmp_path / "result.json"
    result.write_text(json.dumps({"inputs": inputs}))
    for file in (toml, result):
        for plugins in ((), (other,)):
            with pytest.raises(InputError, match=rf"plugins?: names {own}, .*: add --plugin {own}"):
                named_by(file, *plugins)
    assert not list(tmp_path.glob("*.ran"))
    (tmp_path / "link.py").symlink_to(own)
    assert named_by(toml, tmp_path / "link.py").effects[0].name == "my_effect"
    assert (tmp_path / "own.ran").exists()
    assert named_by(result, own).model == "beam"
    # one that lies elsewhere now is known by its content
    moved = own.rename(tmp_path / "moved.py")
    assert named_by(result, moved).plugins[0].path == str(moved)
    assert not caplog.records
    ran(own).write_text(PLUGIN)
    assert named_by(result, own).plugins[0].path == str(own)
    assert f"{own} has changed since that run" in caplog.text


@pytest.mark.parametrize("value", [["/nowhere.py"], {"path": "/nowhere.py"}, 3, [3], [{}], [None]])
def test_no_plugins_of_a_file_come_by_another_way(tmp_path, value):
    result = tmp_path / "result.json"
    result.write_text(json.dumps({"inputs": {"plugins": value}}))
    with pytest.raises(InputError, match="only if the command line names it too"):
        named_by(result)


def test_read_config_names_its_origin(tmp_path):
    path = config(tmp_path, "\nkn = 1e6\n")
    source = read_config(Path(path), DROP_FLAGS)
    assert source.origins == {"kn_N_m": f"{path}:2: kn"}
    assert json.loads(to_json(source.values)) == {"kn_N_m": 1e6}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"diameter_m": 0.8, "length_m": 100.0}, "--diameter 0.8 m is far outside"),
        ({"height_m": 50.0}, "if 50 mm is meant, that is --height 0.05"),
        ({"density_kg_m3": 0.91, "beta_s": 0.0}, "if 0.91 g/cm³ is meant, that is --density 910"),
        ({"kn_N_m": 20.0}, "if 20 MN/m is meant, that is --kn 2e+07"),
        ({"youngs_Pa": 1.5e9}, "what the paper found on steel bristles"),
        ({"density_kg_m3": 1140.0}, "what the paper found on steel bristles"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_what_was_hardly_meant_is_warned_of(values, words):
    assert any(words in warning for warning in input_warnings(drop(model="beam", **values)))


def test_what_may_well_be_meant_is_not_warned_of():
    """Another steel; nylon with a damping of its own; a rigid plane."""
    nylon = {"youngs_Pa": 3e9, "density_kg_m3": 1140.0, "beta_s": 1e-6, "its_s": 1e-6}
    stainless = {"youngs_Pa": 193e9, "density_kg_m3": 8000.0}
    rigid = {"contact": "nitsche", "kn_N_m": math.inf}
    for values in ({}, nylon, stainless, rigid):
        assert input_warnings(drop(model="beam", **values)) == []
