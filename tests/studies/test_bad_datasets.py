"""A dataset that cannot be used is refused by its file and line, whatever its kind."""

from __future__ import annotations

import pytest
from hostile import READERS, TABLES, manifest, write_dataset

from bristle.solver.errors import InputError

pytestmark = pytest.mark.serial

HEAD = "drop,y0_mm,y1_mm\n"
# Four falls, a sample every five minutes.
SPARSE = "".join(f"{fall},{300 * k},0\n" for fall in range(1, 5) for k in range(30))
RIGID = {"length_m": None, "shape": "rigid", "mass_kg": 1}
TWO_GAUGES = "\n".join(f"{row},{row.split(',')[1]}" for row in TABLES["waves"][1].splitlines())
TWO_GAUGES = TWO_GAUGES.replace("gauge,gauge", "gauge,b_V")


def table(rows):
    """Of drops."""
    return {"drops.csv": HEAD + rows}


def cell(line, column, value):
    """A change of one cell of a table."""

    def change(text):
        lines = text.splitlines()
        cells = lines[line - 1].split(",")
        cells[column] = value
        lines[line - 1] = ",".join(cells)
        return "\n".join(lines) + "\n"

    return change


def lines_up_to(count):
    return lambda text: "\n".join(text.splitlines()[:count]) + "\n"


def swapped(text):
    head, one, two, *rows = text.splitlines()
    return "\n".join([head, two, one, *rows]) + "\n"


def with_gravity(text):
    head, *rows = text.splitlines()
    cells = [row.split(",") for row in rows]
    return "\n".join([head, *(f"{n},{t},{9.8 - float(a):.6g}" for n, t, a in cells)]) + "\n"


# By kind: what is changed of a sound one, parts of its manifest (None leaves a key out) or files;
# and what is said. What begins with a colon is said of the line of the last key that is changed.
BAD = {
    "drops": [
        (table(""), "no rows under the columns"),
        (table("1,10,x\n2,2,1\n3,3,1\n"), r"drops.csv:2: y1_mm is no number: 'x'"),
        (table("1,1_0,5\n2,10,5\n3,10,5\n"), r"drops.csv:2: y0_mm is no number: '1_0'"),
        (table("1,٣,5\n2,10,5\n3,10,5\n"), r"drops.csv:2: y0_mm is no number"),
        (table("1,1e308,5\n2,10,5\n3,10,5\n"), "at most 1e.12 in size"),
        (table(f'1,"{"9" * 200_000}",5\n'), r"drops.csv:2: no row of a CSV table"),
        (table("1,10,5\n2,-2,1\n3,3,1\n"), r"drops.csv:3: y0_mm must be more than 0"),
        (table("1,10,5\n2,nan,1\n3,3,1\n"), r"drops.csv:3: y0_mm is nan; leave the cell empty"),
        (table("1,10,5\n2,inf,1\n3,3,1\n"), r"drops.csv:3: y0_mm must be a finite number"),
        (table("1,10,5\n2,10,n/a\n3,3,1\n"), r"y1_mm is no number: 'n/a'; leave the cell empty"),
        (table("n/a,10,5\n2,10,3\n3,3,1\n"), r"drop is no number: 'n/a'$"),
        (
            {"drops.csv": lambda text: text.replace("contact_time_ms", "y1_mm", 1)},
            r"drops.csv:1: column 'y1_mm' appears twice",
        ),
        (table("1,10,5\n2,2\n3,3,1\n"), r"drops.csv:3: 2 values under 3 columns"),
        (table("1,10,5\n1,2,1\n3,3,1\n"), r"drops.csv:3: drop 1 stands in line 2 as well"),
        (table("1,10,5\n"), "too few drops, 1"),
        ({"drops.csv": "drop,y0_mm\n1,2\n"}, r"drops.csv:1: no column y1_mm"),
        (
            {"drops.csv": lambda text: text.replace(",", ";")},
            "csv:1: no column drop; .* comma stands between columns",
        ),
        ({"body": {"lenght_m": 0.3}}, ": lenght_m .* did you mean length_m"),
        ({"body": {"length_m": -1}}, ": length_m: must be greater"),
        ({"body": {"length_m": 5e-324}}, ": length_m: must be greater"),
        ({"body": {"length_m": "long"}}, ": length_m must be a finite number"),
        ({"body": {"roughness": 1}}, ": roughness is not known"),
        ({"body": {"poisson_ratio": 0.7}}, ": poisson_ratio: must be less"),
        ({"body": {"poisson_ratio": -2.0}}, ": poisson_ratio: must be greater"),
        ({"body": {"diameter_m": 1e-3, "width_m": 1e-3}}, "excludes width_m"),
        ({"body": {"length_m": None, "shape": "rigid"}}, ": shape of rigid needs mass_kg"),
        ({"body": {**RIGID, "mass_kg": 0}}, ": mass_kg must be positive"),
        ({"body": {**RIGID, "mass_kg": "1"}}, ": mass_kg must be a finite number"),
        ({"body": {**RIGID, "diameter_m": -1}}, ": diameter_m must be positive"),
        ({"body": {**RIGID, "damping_beta_s": 1e-5}}, ": damping_beta_s is not for a rigid body"),
        (
            {"body": {"shape": "rigid", "mass_kg": 1, "length_m": 0.1}},
            ": length_m is not for a rigid body",
        ),
        ({"body": {"mass_kg": 1, "shape": "cube"}}, ": shape must be one of bristle, rigid"),
        ({"body": {"mass_kg": 1}}, r": mass_kg is for shape = \"rigid\" alone"),
        ({"contact": {"kn_N_m": 16**5000}}, ": kn_N_m must be a finite number, not a value too lo"),
        ({"contact": {"kn_N_m": 1e300}}, ": kn_N_m must lie between"),
        ({"contact": {"kn_N_m": 2}}, ": kn_N_m must lie between 100 and 1e.12, not 2"),
        ({"measurement": {"file": "none.csv"}}, "none.csv: no such file"),
        ({"measurement": {"sigma_y": 3}}, ": sigma_y .*did you mean sigma_y_mm"),
        ({"measurement": {"sigma_y_mm": 0.0}}, ": sigma_y_mm must be positive"),
        ({"measurement": {"sigma_y_mm": 1e-300}}, ": sigma_y_mm must lie between"),
        ({"dataset": {"kind": "dorps"}}, ": kind must be one of"),
        ({"dataset": {"kind": None}}, "dataset.toml: .dataset. needs kind, one of drops, tracks"),
        ({"dataset": {"kind": "waves"}}, ": kind is waves, not drops"),
        ({"dataset": {"title": 5}}, ": title must be a text"),
        ({"dataset": {"title": "x" * 5000}}, ": title must be a text"),
        ({"dataset.toml": "[dataset\n"}, "not valid TOML"),
    ],
    "tracks": [
        ({"tracks.csv": lambda text: text.replace("y_mm", "height", 1)}, "csv:1: no column y_mm"),
        ({"tracks.csv": cell(5, 2, "nan")}, r"tracks\.csv:5: y_mm must be a finite"),
        ({"tracks.csv": cell(6, 1, "0.0")}, r"tracks\.csv:6: t_s must grow"),
        ({"tracks.csv": cell(40, 0, "1")}, r"tracks\.csv:40: drop must count upwards"),
        ({"tracks.csv": lines_up_to(79)}, "3 drops; the loop needs four or more"),
        ({"tracks.csv": lambda text: text + "9,0.0,1.0\n"}, "drop 9 has 1 frames; 6 or more"),
    ],
    "forces": [
        ({"forces.csv": lambda text: text.replace("force_N", "F", 1)}, "forces.csv:1: no column"),
        ({"forces.csv": lambda text: text + "3,1,1\n"}, r"csv:121: drop must count upwards"),
        ({"forces.csv": lambda text: text + "9,1,1\n"}, "drop 9 has 1 samples"),
        ({"drops.csv": cell(3, 0, "1")}, r"drops\.csv:3: drop 1 stands"),
        ({"drops.csv": lines_up_to(7)}, r"forces\.csv:\d+: drop 7 has no height"),
        ({"drops.csv": cell(3, 1, "-15")}, r"drops\.csv:3: y0_mm must be"),
        ({"measurement": {"file": "drops.csv"}}, ": file"),
    ],
    "falls": [
        ({"falls.csv": lines_up_to(61)}, "at least three are needed"),
        ({"falls.csv": lambda text: text + "1,9.0,0.0\n"}, r"falls.csv:122: fall must count upw"),
        ({"falls.csv": swapped}, r"falls.csv:3: t_s must grow"),
        ({"falls.csv": lambda text: text + "99,0.0,0.0\n"}, r"falls.csv:122: fall 99 has 1 sampl"),
        ({"falls.csv": cell(9, 1, "nan")}, r"falls.csv:9: t_s must be"),
        ({"falls.csv": cell(2, 0, "1.5")}, r"falls.csv:2: fall must be a whole number"),
        (
            {"falls.csv": with_gravity},
            r"falls.csv:2: fall 1 reads 9.\d+ m/s² as it begins; .* gravity must not be in a_m_s2",
        ),
        (
            {"falls.csv": "fall,t_s,a_m_s2\n" + SPARSE},
            "falls.csv:2: fall 1 has 30 samples in 8700 s; 40 a second",
        ),
        ({"dataset": {"kind": "drops"}}, ": kind is drops, not falls"),
        ({"measurement": {"file": None}}, "file must name the table"),
    ],
    "waves": [
        *(
            ({"measurement": {"unit": unit}}, ": unit must be a unit such as")
            for unit in ("$\\frac{$", "<b>V</b>", 5, "V" * 50, "")
        ),
        ({"measurement": {"first_pass_s": [2e-5, 1e-5]}}, ": first_pass_s must end after"),
        ({"measurement": {"first_pass_s": 3}}, r": first_pass_s must be \[begin, end\]"),
        ({"measurement": {"first_pass_s": ["0", 1e-5]}}, ": first_pass_s must be a finite number"),
        ({"measurement": {"first_pass_s": None}}, "first_pass_s is missing: .*first pass alone"),
        ({"measurement": {"predict_s": None}}, "predict_s is missing: .*one later pass or more"),
        ({"measurement": {"predict_s": [1.6e-4, 1.0]}}, ": predict_s must lie within"),
        ({"measurement": {"predict_s": [9e-5, 5e-4]}}, ": predict_s must begin after"),
        ({"measurement": {"predict_s": [1.6e-4, 1.62e-4]}}, ": predict_s holds fewer than 8"),
        ({"measurement": {"baseline_until_s": 1e-6}}, ": baseline_until_s must leave 12"),
        ({"measurement": {"baseline_until_s": "early"}}, ": baseline_until_s must be a finite"),
        ({"measurement": {"signal": ["gauge", "gauge"]}}, ": signal"),
        ({"measurement": {"signal": ["gauge", "c_V"]}}, "waves.csv:1: no column c_V"),
        (
            {"measurement": {"signal": None, "singal": ["gauge"]}},
            "singal is not known; did you mean signal",
        ),
        ({"measurement": {"file": "../waves.csv"}}, "lies outside"),
        ({"measurement": {"gauge_x_m": 0.4}}, ": gauge_x_m must lie between the ends"),
        ({"measurement": {"gauge_x_m": True}}, ": gauge_x_m must be a finite number"),
        ({"measurement": {"signal_2": "gauge"}}, ": signal_2 names a column of signal"),
        (
            {"measurement": {"signal_2": "b_V"}, "waves.csv": TWO_GAUGES},
            "gauge_x_m is missing: with two gauges",
        ),
        (
            {
                "measurement": {"signal_2": "b_V", "gauge_x_m": 0.1, "gauge_2_x_m": 0.05},
                "waves.csv": TWO_GAUGES,
            },
            ": gauge_2_x_m must be farther",
        ),
        (
            {
                "measurement": {
                    "signal_2": "b_V",
                    "gauge_x_m": 0.05,
                    "gauge_2_x_m": 0.1,
                    "predict_s": [1e-5, 5e-4],
                },
                "waves.csv": TWO_GAUGES,
            },
            ": predict_s must not begin before the first pass does",
        ),
        ({"measurement": {"gauge_2_x_m": 0.15}}, ": gauge_2_x_m needs signal_2"),
        *(({"measurement": {"sigma": x}}, ": sigma must be positive") for x in (0.0, -1.0)),
        ({"waves.csv": cell(102, 0, "1.004e-4")}, "waves.csv:102: t_s must grow in equal steps"),
        (
            {"waves.csv": lambda text: text.replace(text.splitlines()[101] + "\n", "")},
            "waves.csv:102: .* no sample may be missing",
        ),
        ({"waves.csv": cell(10, 1, "nan")}, "waves.csv:10: gauge must be a finite number"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "changes", "says"),
    [(kind, *case) for kind, cases in BAD.items() for case in cases],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_a_dataset_is_refused_by_file_and_line(tmp_path, kind, changes, says):
    tree, stands = manifest(kind), ""
    for part in tree.keys() & changes.keys():
        # what is changed stands below what is not
        both = {key: each for key, each in tree[part].items() if key not in changes[part]}
        both |= changes[part]
        tree[part] = {key: value for key, value in both.items() if value is not None}
        stands = list(changes[part])[-1]
    folder = write_dataset(tmp_path / "data", kind, tree)
    for name in changes.keys() - tree.keys():
        change, path = changes[name], folder / name
        path.write_text(change(path.read_text()) if callable(change) else change)
    if says.startswith(":"):
        lines = (folder / "dataset.toml").read_text().splitlines()
        (number,) = [n for n, text in enumerate(lines, 1) if text.startswith(f'"{stands}"')]
        says = f"dataset.toml:{number}{says}"
    with pytest.raises(InputError, match=says):
        READERS[kind](folder)
