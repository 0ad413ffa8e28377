"""Effects from outside: what is taken in, what it does to drops, and whether the loop finds it."""

from __future__ import annotations

import json
import logging
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from made_drops import QUICK, write_drops

import bristle
from bristle.solver.bristle import Bristle
from bristle.solver.contact.laws import Damped, HuntCrossley, Linear
from bristle.solver.effects import outside
from bristle.solver.effects.base import Effect, Parameter, Place, Scene
from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import InputError
from bristle.studies.cli import main
from bristle.studies.loop.kinds.drops import problem as drops_module
from bristle.studies.loop.responses import emulator as emulator_module
from bristle.studies.loop.responses.drop_model import DropModel, Drops
from bristle.studies.loop.responses.emulator import PLAIN_STEP, Emulator, effect_at
from bristle.studies.loop.responses.errors import Errors

pytestmark = pytest.mark.serial

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "my_effect.py"
LAW, PLASTIC = EXAMPLE.with_name("my_law.py"), EXAMPLE.with_name("my_plastic_law.py")
SPEC = "my_effect:exponent=-0.5"


@pytest.fixture(autouse=True)
def own_effects():
    """What a test takes in is gone after it."""
    before = dict(EFFECTS)
    yield
    EFFECTS.clear()
    EFFECTS.update(before)
    for name in [name for name in sys.modules if name.startswith("bristle_plugin_")]:
        del sys.modules[name]


@dataclass(frozen=True)
class Good(Effect):
    """Two numbers: a share of Kn, and damping on top."""

    share: float = 0.5
    more_s: float = 1e-6

    name = "two_numbers"
    title = "softer and damped"
    place = Place.CONTACT
    kinds = frozenset({"drops"})
    source = "a test"
    parameters = (
        Parameter("share", "", 0.5, 2.0, 0.7, null=1.0, logarithmic=True),
        Parameter("more_s", "s", 0.0, 1e-5, 5e-6),
    )

    def enter(self, scene: Scene) -> Scene:
        law = Linear(scene.law.kn_N_m * self.share)
        return replace(scene, law=law, beta_s=scene.beta_s + self.more_s)


MODELS = {"beam": {}, "reduced": {"cells": (1, 2, 12)}, "solid": {"cells": (1, 2, 12)}}


def drops_of_all_models(**asked):
    return [bristle.drop(model=model, **asked, **more) for model, more in MODELS.items()]


def test_the_analytic_model_takes_none():
    with pytest.raises(InputError, match="my_effect is not for the analytic model"):
        bristle.drop(model="analytic", plugins=[EXAMPLE], effects=[SPEC])


@pytest.mark.parametrize("model", MODELS)
def test_every_model_takes_it(model):
    """From 10 mm the example is a contact of 2 MN/m × 5^(1/4), and nothing else."""
    asked = {"model": model, "length_m": 0.1, "height_m": 0.01, **MODELS[model]}
    found = bristle.drop(**asked, plugins=[EXAMPLE], effects=[SPEC])
    same = bristle.drop(**asked, kn_N_m=2e6 * 5.0**0.25)
    assert found.peak_force_N == pytest.approx(same.peak_force_N, rel=1e-12)
    assert found.rebound_ratio == pytest.approx(same.rebound_ratio, rel=1e-12)
    assert found.rebound_ratio != bristle.drop(**asked).rebound_ratio


def test_every_model_takes_a_law_of_ones_own():
    """A film of 5 µm makes contact longer and softer, in 3-D as in 1-D, and takes no energy."""
    short = {"length_m": 0.1, "tip": "face", "beta_s": 0.0}
    plugin = {"plugins": [LAW], "effects": ["my_law:film_m=5e-6"]}
    found = drops_of_all_models(**short, **plugin)
    plain = bristle.drop(model="beam", **short)
    for each in found:
        assert each.contact_time_s > 1.1 * plain.contact_time_s
        assert each.energy["closure_relative"] < 1e-9
        assert each.energy["contact_loss_J"] == 0.0
        # beam and solid differ by Poisson's ratio at the tip and by their meshes
        assert each.contact_time_s == pytest.approx(found[0].contact_time_s, rel=5e-3)
        assert each.peak_force_N == pytest.approx(found[0].peak_force_N, rel=5e-3)


def test_every_model_takes_a_law_with_a_memory():
    """Yielding takes energy, which the budgets of all three have, and the rest comes back."""
    asked = {"length_m": 0.1, "tip": "face", "beta_s": 0.0, "its_s": 1e-6}
    asked |= {"plugins": [PLASTIC], "effects": ["my_plastic_law:yield_N=20"]}
    found = drops_of_all_models(**asked)
    for each in found:
        lost = each.energy["contact_loss_J"] / each.energy["initial_J"]
        assert 0.02 < lost < 1.0 - each.cm_velocity_after_m_s**2 / each.impact_speed_m_s**2 + 1e-3
        assert each.energy["closure_relative"] < 1e-6  # the solid flies in the modes
        assert each.peak_force_N > 20.0
        assert each.rebound_ratio == pytest.approx(found[0].rebound_ratio, abs=5e-3)


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("share * kn, stored", "kn, stored", "not the slope"),
        ("0.5 * kn * depth * depth", "kn * depth * depth", "not of its potential"),
        ("approach - force / (scale * law[0])", "0.5 * approach", "once what a step leaves"),
        ("if depth <= 0.0", "if depth <= -1.0", "before it is touched"),
        ("kn, most, share = scale", "kn, most, share = foo", "name 'foo' is not defined"),
        ("return indented", "return 'deep'", "No conversion"),
    ],
    ids=["tangent", "potential", "memory", "touch", "name", "type"],
)
def test_a_wrong_law_is_refused_with_the_reason(before, after, why):
    source = PLASTIC.read_text()
    assert before in source
    with pytest.raises(ValueError, match=f"contact law .*{why}"):
        outside.load(PLASTIC, source.replace(before, after).encode())


@pytest.mark.parametrize("share", ["0.0", "1e-3"])
def test_a_law_that_hardly_hardens_is_taken(share):
    """Its tangent falls from Kn to next to nothing between two of the points it is tried at."""
    source = PLASTIC.read_text().replace("self.yield_N, 0.1)", f"self.yield_N, {share})")
    outside.load(PLASTIC, source.replace('"my_plastic_law"', f'"flat_{share[0]}"').encode())


def test_a_run_is_repeated_from_its_result(tmp_path, capsys):
    own = tmp_path / "own.py"
    own.write_text(EXAMPLE.read_text())
    asked = ["drop", "--model", "beam", "--plugin", str(own), "--effect", SPEC]
    assert main([*asked, "--out", str(tmp_path / "one")]) == 0
    again = ["drop", "--config", str(tmp_path / "one" / "result.json")]
    assert main([*again, "--out", str(tmp_path / "two")]) == 2
    assert f"add --plugin {own}" in capsys.readouterr().err
    again += ["--plugin", str(own)]
    assert main([*again, "--out", str(tmp_path / "two")]) == 0
    one, two = (
        json.loads((tmp_path / name / "result.json").read_text()) for name in ("one", "two")
    )
    assert one["inputs"] == two["inputs"]
    assert one["rebound_ratio"] == two["rebound_ratio"]
    own.write_text(EXAMPLE.read_text() + "\n# another\n")
    capsys.readouterr()
    assert main([*again, "--out", str(tmp_path / "three")]) == 2
    assert "has changed since that run" in capsys.readouterr().err


def test_the_loop_finds_it(tmp_path, monkeypatch):
    """Drops of the beam with the example in them, with five others on the list."""
    outside.load(EXAMPLE, EXAMPLE.read_bytes())
    names = [*QUICK, "my_effect"]
    monkeypatch.setattr(drops_module, "carried", lambda kind, quantities: names)
    data = write_drops(tmp_path / "data", [EFFECTS["my_effect"](exponent=-1.0)], "mystery")
    found = bristle.close_loop(data, plugins=[str(EXAMPLE)], seed=1, no_3d=True)
    assert found.verdict == "effect"
    assert found.effects == ["my_effect"]
    told = found.parameters.exponent
    # 90 % intervals: the truth lies within twice their width all but always
    assert abs(told.estimate + 1.0) < told.high - told.low
    assert found.held_out.rms_after < 0.5 * found.held_out.rms_before


@pytest.mark.parametrize(
    ("name", "values", "heights"),
    # The last at nodes: seven are too few for forces from 5 to 200 N, and where it begins to yield
    # it has a kink over the height.
    [
        ("two_numbers", (0.8, 3e-6), (0.025, 0.04)),
        ("my_law", (9e-6,), (0.025, 0.04)),
        ("my_plastic_law", (5.0 * 40.0 ** (1 / 3),), (0.016, 0.032)),
    ],
)
def test_a_table_is_made_over_its_parameters(name, values, heights, monkeypatch):
    """Between nodes, against drops simulated one by one."""
    outside.register(Good, "a test")
    for path in (LAW, PLASTIC):
        outside.load(path, path.read_bytes())
    monkeypatch.setattr(emulator_module, "EFFECT_NODES", 5)
    monkeypatch.setattr(emulator_module, "DECADES_NODES", 7)
    monkeypatch.setattr(emulator_module, "LEAN_KN_NODES", 5)
    emulator = Emulator(Bristle(), 9.8, 0.02, 0.05, (1e6, 4e6))
    kns = np.array([1.7e6, 2.3e6])
    at = [np.full((1, 1), value) for value in values]  # (nodes of chance, drops), as models ask
    told = emulator.change(name, np.array([heights]), kns[None], *at)[:, 0]
    for i, (height, kn) in enumerate(zip(heights, kns, strict=True)):
        plain = replace(emulator.scene(), height_m=height, law=Linear(kn))
        scenes = [effect_at(name, *values).enter(plain)], [plain]
        step = emulator.step_s(kn)
        with_it, without = (np.log(emulator.observed(each, step, 0.0)[0]) for each in scenes)
        assert told[:, i] == pytest.approx(with_it - without, abs=2e-3)


@dataclass(frozen=True)
class Wetting(Effect):
    """Contact that softens with the drops made, by another amount in each; and a slow camera."""

    decades: float = 0.2
    slow: float = 0.01

    name = "wetting"
    title = "a surface that gets wet"
    place = Place.SURFACE
    kinds = frozenset({"drops"})
    source = "a test"
    random = True
    computed = True
    parameters = (
        Parameter("decades", "decades", 0.0, 1.0, 0.2),
        Parameter("slow", "", 0.0, 0.1, 0.01),
    )

    def enter(self, scene: Scene) -> Scene:
        drier = self.decades * (0.1 * scene.order**0.5 + 0.5 * scene.chance[0])
        law = Linear(scene.law.kn_N_m * 10.0**-drier)
        return replace(scene, law=law, t_scale=scene.t_scale * (1.0 + self.slow))


def damped(effect, scene):
    """What a computed effect may not do: another contact law."""
    present = effect.decades * effect.slow
    return replace(scene, law=Damped(scene.law.kn_N_m, effect.slow)) if present else scene


def test_a_computed_effect_is_known_for_every_drop_and_chance():
    """As models predict it for all drops at once, against drops simulated one by one."""
    outside.register(Wetting, "a test")
    emulator = Emulator(Bristle(), 9.8, 0.02, 0.05, (2e5, 2e7))
    heights, order = np.array([0.025, 0.04, 0.05]), np.array([0.0, 4.0, 9.0])
    drops = Drops(emulator, heights, order, (0, 1, 2))
    kn = Parameter("kn_N_m", "N/m", 1e6, 4e6, 2e6)
    errors = Errors.independent(np.ones(3), np.ones((3, 3), dtype=bool))
    model = DropModel(drops, kn, ("wetting",), errors)
    theta = np.array([2.2e6, 0.3, 0.02])
    predicted = model.measured(theta)
    chances = np.linspace(-3.25, 3.25, len(model.weights))
    assert model.weights @ chances == pytest.approx(0.0, abs=1e-12)
    # of a normal number that ends at 3.25: 1 - 2 a φ(a) / (1 - 2 Φ(-a)) = 0.987
    assert model.weights @ chances**2 == pytest.approx(0.987, abs=3e-3)
    for node in (0, 20, 52):
        for i, (height, number) in enumerate(zip(heights, order, strict=True)):
            plain = replace(
                emulator.scene(),
                height_m=height,
                law=Linear(theta[0]),
                order=number,
                chance=(chances[node], 0.0),
            )
            scene = Wetting(*theta[1:]).enter(plain)
            step = PLAIN_STEP * emulator.step_s(scene.law.kn_N_m)
            alone = emulator.observed([scene], step, 0.0)[0] * (1.0, scene.t_scale, 1.0)
            assert predicted[node, i] == pytest.approx(alone, rel=2e-3)


def sets(**rules):
    """An effect that sets numbers of a scene by rules of itself and the scene."""
    return {"enter": lambda self, s: replace(s, **{n: of(self, s) for n, of in rules.items()})}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            sets(drag_kg_m=lambda e, _: math.sqrt(e.decades + e.slow)),
            "fails for many drops at once: TypeError",
        ),
        (
            sets(t_scale=lambda e, s: 1.0 + e.slow * np.size(s.order) * e.decades),
            "its t_scale for many drops is another",
        ),
        ({"random": False}, "by chance from drop to drop: say so"),
        ({"computed": False}, "changes t_scale: computed = True is for these"),
        (
            sets(beta_s=lambda e, s: s.beta_s + e.slow * e.decades),
            "beta_s: computed = False is for",
        ),
        (sets(tilt_deg=lambda e, _: e.slow * e.decades), "tilt_deg: the loop takes these from its"),
        ({"enter": damped}, "no more of the contact law than its stiffness"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_a_computed_effect_that_is_none_is_refused(change, words):
    kind = dataclass(frozen=True)(type("Bad", (Wetting,), dict(change)))
    with pytest.raises(InputError, match=words):
        outside.register(kind, "a test")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "Two Numbers"}, "small letters"),
        ({"name": "air_drag"}, "of this name already"),
        ({"title": ""}, "has no title"),
        ({"place": "contact"}, "must be one of Place"),
        ({"kinds": frozenset({"waves"})}, "its kinds may be drops, forces, tracks"),
        ({"parameters": Good.parameters[:1]}, "its fields must be its parameters"),
        ({"parameters": (Good.parameters[0], Parameter("more_s", "s", 0.0, 1.0, 2.0))}, "more_s"),
        (
            {"parameters": (Good.parameters[0], replace(Good.parameters[1], refines=True))},
            "no parameter may have refines",
        ),
        ({"enter": lambda self, scene: scene}, "changes nothing"),
        (sets(drag_kg_m=lambda e, _: e.more_s * e.share), "drag_kg_m"),
        (sets(beta_s=lambda e, _: e.share * e.more_s + 1e-9), "absence"),
        (sets(height_m=lambda e, _: e.share), "height_m"),
        (sets(beta_s=lambda e, _: 1e-6 * e.more_s), "share changes"),
        ({"enter": lambda self, scene: None}, "must return a Scene"),
        ({"enter": lambda self, scene: 1.0 / 0.0}, "ZeroDivisionError"),
        (sets(law=lambda e, _: Linear(e.more_s - 0.5)), "Kn must be"),
        (
            sets(beta_s=lambda e, s: s.beta_s + e.more_s * e.share * s.chance[0]),
            "differs from drop to drop",
        ),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_what_nobody_could_predict_is_refused_by_name(change, words):
    kind = dataclass(frozen=True)(type("Bad", (Good,), dict(change)))
    with pytest.raises(InputError, match=words):
        outside.register(kind, "a test")
    assert "two_numbers" not in EFFECTS


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "defines no subclass"),
        ("def broken(:", "SyntaxError"),
        ("import nowhere_at_all", "ModuleNotFoundError"),
        (EXAMPLE.read_text().replace('"my_effect"', '"wear"'), "of this name already"),
    ],
)
def test_files_that_are_none_end_with_status_2(text, words, tmp_path, capsys):
    path = tmp_path / "own.py"
    path.write_text(text)
    asked = ["drop", "--model", "beam", "--plugin", str(path), "--out", str(tmp_path / "out")]
    assert main(asked) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(f"bristle: error: --plugin: {path}")
    assert words in last
    assert not (tmp_path / "out").exists()


def test_an_installed_package_brings_its_own(monkeypatch, caplog):
    def point(name, found):
        def load():
            if found is None:
                raise ImportError("gone")
            return found

        package = SimpleNamespace(version="1.0")
        return SimpleNamespace(name=name, value=f"package:{name}", dist=package, load=load)

    points = [point("good", Good), point("broken", None)]
    monkeypatch.setattr(outside, "entry_points", lambda group: points)
    outside.load_installed.cache_clear()
    with caplog.at_level(logging.WARNING, logger="bristle"):
        found = bristle.drop(model="beam", effects=["two_numbers:share=0.5,more_s=0"])
    assert found.rebound_ratio == bristle.drop(model="beam", kn_N_m=1e6).rebound_ratio
    assert [record.getMessage() for record in caplog.records] == [
        "the effect broken of an installed package is left out: gone"
    ]
    outside.load_installed.cache_clear()


def test_a_parameter_is_what_its_effect_says_whatever_its_name():
    """`beta_s` of an effect from outside adds to the material's, and is not it."""

    @dataclass(frozen=True)
    class MoreBeta(Effect):
        share: float = 1.0
        beta_s: float = 0.0

        name, title, source = "more_beta", "more damping", "a test"
        place, kinds = Good.place, Good.kinds
        parameters = (Good.parameters[0], Parameter("beta_s", "s", 0.0, 1e-5, 5e-6))

        def enter(self, scene):
            return replace(scene, beta_s=scene.beta_s + self.beta_s * self.share)

    outside.register(MoreBeta, "a test")
    emulator = Emulator(Bristle(), 9.8, 0.02, 0.05)
    assert emulator.parameters("more_beta") == MoreBeta.parameters


def test_an_effect_may_scale_the_damping_with_height():
    @dataclass(frozen=True)
    class Scaled(Good):
        name = "scaled"

        def enter(self, scene):
            more = self.share * (1.0 + self.more_s * scene.height_m)
            return replace(scene, beta_s=scene.beta_s * more)

    outside.register(Scaled, "a test")
    assert "scaled" in EFFECTS


def test_two_laws_at_once_are_refused():
    def of(name, law):
        enter = lambda self, s: replace(s, law=law(s.law.kn_N_m * self.share, self.more_s * 1e6))  # noqa: E731
        return dataclass(frozen=True)(
            type(name, (Good,), {"name": name, "kinds": frozenset(), "enter": enter})
        )

    for name, law in (("law_a", Damped), ("law_b", HuntCrossley)):
        outside.register(of(name, law), "a test")
    with pytest.raises(InputError, match="law_b replaces the contact law of another"):
        bristle.drop(model="beam", effects=["law_a:share=0.7", "law_b:share=0.7"])


def test_a_file_s_effects_are_known_to_the_call_that_names_it(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(EXAMPLE.read_text())
    asked = {"model": "beam", "height_m": 0.01, "effects": [SPEC]}
    before = bristle.drop(**asked, plugins=[path])
    path.write_text(EXAMPLE.read_text().replace("REFERENCE_M = 0.05", "REFERENCE_M = 0.01"))
    after = bristle.drop(**asked, plugins=[path])
    assert before.peak_force_N > after.peak_force_N
    other = tmp_path / "other.py"
    other.write_text(EXAMPLE.read_text())
    assert bristle.drop(**asked, plugins=[other]).peak_force_N == before.peak_force_N
    with pytest.raises(InputError, match="there is an effect of this name already"):
        bristle.drop(**asked, plugins=[path, other])
    with pytest.raises(InputError, match="names an unknown effect 'my_effect'"):
        bristle.drop(**asked)
    assert "my_effect" not in EFFECTS
