"""What a hostile user or dataset could hand to the program: strategies, and what is promised.

Whatever comes in, a command ends with a status of CONTRACT.md, and where that is not 0 with one
line that names what was wrong.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
from pathlib import Path

from hypothesis import strategies as st

from bristle.studies.cli import main
from bristle.studies.data import datasets
from bristle.studies.data.datasets import read_drops
from bristle.studies.inputs.fields import DROP_FLAGS, LIST_FLAGS
from bristle.studies.loop.kinds.falls.record import read_falls
from bristle.studies.loop.kinds.forces.record import read_forces
from bristle.studies.loop.kinds.tracks.record import read_tracks
from bristle.studies.loop.kinds.waves.record import read_waves

ERROR = re.compile(r"^bristle: error: \S.*$")
CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")


def run(*arguments):
    """The command line in this process: status, standard output, lines of standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main([str(argument) for argument in arguments])
    return status, out.getvalue(), err.getvalue().split("\n")[:-1]


def kept_promise(status, lines):
    """The message of an end that is none of success, once it is as promised; "" of success."""
    assert "Traceback" not in "".join(lines)
    assert status in (0, 1, 2), lines
    if status == 0:
        return ""
    assert ERROR.match(lines[-1]), lines
    assert "unexpected" not in lines[-1], lines
    assert not CONTROL.search(lines[-1]), lines
    return lines[-1].removeprefix("bristle: error: ")


def refused(*arguments):
    """The message of a command that must end with status 2, without the prefix."""
    status, _, lines = run(*arguments)
    assert status == 2, lines
    return kept_promise(status, lines)


# --- values and files -----------------------------------------------------------------------------

NASTY_TEXT = st.one_of(
    st.text(max_size=8),
    st.sampled_from(
        [
            "",
            "nan",
            "inf",
            "-0.0",
            "1e400",
            "5e-324",
            "٣",
            "1_0",
            "0x10",
            "'",
            '"',
            "\x1b[31m",
            "\u202e",
            "$\\frac{$",
            "=1+1",
            "<script>alert(1)</script>",
            "../../etc/passwd",
            "/etc/passwd",
            "a\x00b",
            "x" * 5000,
            "{{ 7 * 7 }}",
            "%s%n",
        ]
    ),
)
NASTY_NUMBERS = st.one_of(
    st.floats(),
    st.integers(),
    st.sampled_from([0, -1, 10**30, 10**400, 1e308, -1e308, 5e-324, 1e-310, 2**63, 2**31]),
)
LEAVES = st.one_of(NASTY_NUMBERS, NASTY_TEXT, st.booleans(), st.datetimes())
TREES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(NASTY_TEXT, inner, max_size=3)
    ),
    max_leaves=6,
)


def toml(value):
    """A value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{toml(k)} = {toml(v)}' for k, v in value.items())}}}"
    if isinstance(value, int):
        return hex(value) if value > 0 else str(value)  # decimal ones end at 4300 digits
    return value.isoformat()


def document(tree):
    """A TOML document of tables and values at its top."""
    plain = {key: value for key, value in tree.items() if not isinstance(value, dict)}
    tables = {key: value for key, value in tree.items() if isinstance(value, dict)}
    lines = [f"{toml(key)} = {toml(value)}" for key, value in plain.items()]
    for name, table in tables.items():
        lines.append(f"[{toml(name)}]")
        lines += [f"{toml(key)} = {toml(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


def spoilt(draw, text):
    """The bytes of a text, as a careless editor, a bad disk or nobody would leave them."""
    content = text.encode("utf-8", "surrogatepass")
    how = draw(
        st.sampled_from(["", "", "", "", "bom", "crlf", "cut", "changed", "latin", "utf-16"])
    )
    if how == "bom":
        return b"\xef\xbb\xbf" + content
    if how == "crlf":
        return content.replace(b"\n", b"\r\n")
    if how == "cut":
        return content[: draw(st.integers(0, len(content)))]
    if how == "changed":
        at = draw(st.integers(0, max(len(content) - 1, 0)))
        return content[:at] + draw(st.binary(max_size=4)) + content[at + 1 :]
    if how == "latin":
        return text.encode("latin-1", "replace") + b"\xb5"
    if how == "utf-16":
        return text.encode("utf-16", "replace")
    return content


# --- configurations -------------------------------------------------------------------------------

CONFIG_KEYS = [flag.name for flag in (*DROP_FLAGS, *LIST_FLAGS)]
SENSIBLE = {
    "kn": 2e6,
    "height": 0.05,
    "model": "analytic",
    "its": 1e-5,
    "until": "impact",
    "cells": [1, 1, 20],
    "effect": ["air_drag:cd=1.1"],
    "tilt": 2.0,
    "contact": "nitsche",
    "tip-shape": "rounded:radius=1e-4",
    "models": "beam",
    "heights": [0.01],
}


@st.composite
def configurations(draw):
    """The bytes of a configuration file, most of them nonsense."""
    keys = draw(st.lists(st.one_of(st.sampled_from(CONFIG_KEYS), NASTY_TEXT), max_size=4))
    tree = {}
    for key in keys:
        sensible = key in SENSIBLE and draw(st.booleans())
        tree[key] = SENSIBLE[key] if sensible else draw(TREES)
    return spoilt(draw, document(tree))


# --- datasets -------------------------------------------------------------------------------------


def drops_table(n=8):
    rows = "".join(f"{i},{10 + 5 * (i % 4)},{6 + 3 * (i % 4)},0.16,40\n" for i in range(1, n + 1))
    return f"drop,y0_mm,y1_mm,contact_time_ms,peak_force_N\n{rows}"


def tracks_table():
    """Rest, fall from 40 to 50 mm, and rise, at 100 frames a second."""
    rows = []
    for drop in range(1, 9):
        y0 = 0.04 + 0.002 * (drop % 5)
        fall_s, up_m_s = (2.0 * y0 / 9.8) ** 0.5, (2.0 * 9.8 * 0.65 * y0) ** 0.5
        for k in range(26):
            t = 0.01 * k - 0.05
            after = t - fall_s
            y = y0 - 4.9 * max(t, 0.0) ** 2 if after < 0.0 else up_m_s * after - 4.9 * after**2
            rows.append(f"{drop},{0.01 * k:.4g},{1e3 * y + 0.2 * math.sin(7.0 * k * drop):.4f}\n")
    return "drop,t_s,y_mm\n" + "".join(rows)


def forces_table():
    rows = [
        f"{drop},{1e-5 * k:.6g},{40.0 * max(0, 1 - (k / 8 - 1) ** 2):.4g}\n"
        for drop in range(1, 8)
        for k in range(17)
    ]
    return "drop,t_s,force_N\n" + "".join(rows)


def waves_table():
    """A gauge at mid-length that sees a pulse pass every 65 µs, and noise."""
    rows = []
    for k in range(800):
        passed = [math.exp(-(((k - 110 - 65 * n) / 12.0) ** 2)) * (-0.98) ** n for n in range(12)]
        rows.append(f"{1e-6 * k:.7g},{sum(passed) + 1e-3 * math.sin(37.0 * k * k):.6g}\n")
    return "t_s,gauge\n" + "".join(rows)


def falls_table():
    rows = [f"{fall},{0.01 * k:.4g},{0.05 * k:.4g}\n" for fall in range(1, 5) for k in range(30)]
    return "fall,t_s,a_m_s2\n" + "".join(rows)


TABLES = {
    "drops": ("drops.csv", drops_table()),
    "tracks": ("tracks.csv", tracks_table()),
    "forces": ("forces.csv", forces_table()),
    "waves": ("waves.csv", waves_table()),
    "falls": ("falls.csv", falls_table()),
}
READERS = {
    "drops": read_drops,
    "tracks": read_tracks,
    "forces": read_forces,
    "waves": read_waves,
    "falls": read_falls,
}
WAVE_KEYS = {
    "signal": "gauge",
    "unit": "V",
    "baseline_until_s": 8e-5,
    "first_pass_s": [9.5e-5, 1.4e-4],
    "predict_s": [1.6e-4, 5e-4],
}


def manifest(kind, **changed):
    """A sound ``dataset.toml`` as a tree; ``changed`` replaces whole tables of it."""
    tree = {
        "dataset": {"title": "T", "kind": kind, "source": "S", "licence": "L"},
        "body": {"length_m": 0.3365},
        "contact": {},
        "measurement": {"file": TABLES[kind][0], "sigma_y_mm": 0.5},
    }
    if kind == "waves":
        tree["measurement"] |= WAVE_KEYS
    return {**tree, **changed}


def write_dataset(folder, kind, tree=None, table=None):
    """A dataset of that kind in ``folder``; sound where nothing else is given."""
    folder.mkdir(parents=True, exist_ok=True)
    name, sound = TABLES[kind]
    text = document(tree or manifest(kind))
    (folder / "dataset.toml").write_bytes(text if isinstance(text, bytes) else text.encode())
    content = sound if table is None else table
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    if kind == "forces":
        (folder / "drops.csv").write_text(drops_table())
    return folder


CELLS = st.one_of(
    st.floats().map(repr),
    st.integers(-5, 10).map(str),
    NASTY_TEXT,
    st.sampled_from(["", "1e300", "9" * 400, "-1", "0", "1;2", "1,2", '"', '"a\nb"', "1e308"]),
)


SPOILINGS = ["cell", "cell", "column", "drop-row", "double", "swap", "constant", "none", "ragged"]


@st.composite
def tables(draw, kind):
    """The bytes of a table with some of it spoilt."""
    head, *rows = TABLES[kind][1].splitlines()
    rows = [row.split(",") for row in rows]
    for _ in range(draw(st.integers(0, 3))):
        how = draw(st.sampled_from(SPOILINGS))
        i = draw(st.integers(0, max(len(rows) - 1, 0)))
        j = draw(st.integers(0, len(rows[0]) - 1 if rows else 0))
        if how == "none":
            rows = []
        if not rows:
            break
        if how == "cell":
            rows[i][j : j + 1] = [draw(CELLS)]
        elif how == "column":
            value = draw(CELLS)
            rows = [[*row[:j], value, *row[j + 1 :]] for row in rows]
        elif how == "drop-row":
            del rows[i : i + draw(st.integers(1, len(rows)))]
        elif how == "double":
            rows.insert(i, list(rows[i]))
        elif how == "swap":
            rows[i], rows[0] = rows[0], rows[i]
        elif how == "constant":
            rows = [list(rows[i]) for _ in rows]
        elif how == "ragged":
            rows[i] = rows[i][: draw(st.integers(1, len(rows[i])))]
    if draw(st.integers(0, 9)) == 0:
        names = head.split(",")
        names[draw(st.integers(0, len(names) - 1))] = draw(
            st.one_of(NASTY_TEXT, st.sampled_from(names))
        )
        head = ",".join(names)
    separator = draw(st.sampled_from([",", ",", ",", ",", ",", ";", "\t"]))
    text = "\n".join(separator.join(row) for row in [head.split(","), *rows]) + "\n"
    return spoilt(draw, text)


KEYS = {
    "dataset": ("title", "kind", "source", "licence"),
    "body": tuple(datasets.BODY_KEYS),
    "contact": ("kn_N_m",),
    "measurement": datasets.MEASUREMENT_KEYS,
}


@st.composite
def manifests(draw, kind):
    """The tree of a manifest with some of it spoilt."""
    tree = manifest(kind)
    for _ in range(draw(st.integers(0, 3))):
        part = draw(st.sampled_from(list(KEYS)))
        how = draw(st.sampled_from(["value", "value", "value", "key", "missing", "part"]))
        if how == "part":
            tree[part] = draw(TREES)
            continue
        if not isinstance(tree[part], dict):
            continue
        key = draw(st.sampled_from(KEYS[part]))
        if how == "value":
            tree[part] = {**tree[part], key: draw(TREES)}
        elif how == "key":
            tree[part] = {**tree[part], draw(NASTY_TEXT): draw(TREES)}
        else:
            tree[part] = {k: v for k, v in tree[part].items() if k != key}
    return tree


@st.composite
def hostile_datasets(draw, kind):
    """The files of a dataset by name."""
    sound = draw(st.booleans())
    text = document(manifest(kind) if sound else draw(manifests(kind)))
    files = {"dataset.toml": text.encode("utf-8") if sound else spoilt(draw, text)}
    files[TABLES[kind][0]] = draw(tables(kind))
    if kind == "forces":
        files["drops.csv"] = draw(tables("drops"))
    return files


def write_files(folder: Path, files):
    """These files in a new folder."""
    folder.mkdir(parents=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder
