"""Rates of the loop on blind datasets: makes them, runs the loop on each, prints a table.

docker/run python3 tests/blind_loop.py --datasets 20 --seed 1 [--rows clean,listed16] [--jobs 2]
    [--out results/blind] [--resume]

A dataset's line goes into outcomes.jsonl as soon as it is done; with --resume finished ones are
kept. The datasets come from tests/reference/blind, which shares nothing with the loop.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
sys.path.insert(0, str(Path(__file__).parent / "reference"))

from blind.make import ROWS, NoDesign, make  # noqa: E402
from blind.table import Outcome, lost, table  # noqa: E402

JOURNAL = "outcomes.jsonl"
Case = tuple[int, str, int]


def run_case(case: Case, keep: Path | None = None) -> Outcome:
    """Make the dataset ``case`` (seed, row, number) and run the loop on its files.

    ``verdict`` is "refused" where the loop raised an error, whose text stands in ``error``. The
    files go into ``keep`` where that is given. It is "not made" where no design has the misfit.
    """
    try:
        made = make(*case)
    except NoDesign as error:
        row, number = case[1:]
        return _lost("not made", str(error)) | {"row": row, "number": number, "truth": ""}
    with tempfile.TemporaryDirectory() as temporary:
        folder = keep or Path(temporary)
        made.write(folder)
        return made.record() | _verdict(folder, case)


def _verdict(folder: Path, case: Case) -> Outcome:
    """What the loop says of the dataset in ``folder``, without its page."""
    from bristle.solver.errors import ComputationError, InputError
    from bristle.studies.close_loop.run import LoopInputs, close, problem_of, verdict
    from bristle.studies.data.datasets import read_manifest

    began = time.perf_counter()
    try:
        manifest = read_manifest(folder)
        inputs = LoopInputs(seed=case[2], no_3d=True)
        said = verdict(close(manifest, problem_of(manifest), inputs))
    except (InputError, ComputationError) as error:
        return _lost("refused", str(error))
    except Exception:  # a program that breaks on one dataset is to be seen beside all others
        return _lost("refused", traceback.format_exc())
    keys = ("verdict", "effects", "weights", "classes", "parameters", "held_out", "detection")
    kept: dict[str, Any] = {key: said[key] for key in keys}
    return kept | {
        "probabilities": said.get("probabilities"),
        "open_set": said["open_set"],
        "rms_sigma": said["fit"]["rms_sigma"],
        "warnings": said["warnings"],
        "wall_s": time.perf_counter() - began,
        "error": "",
    }


def _lost(verdict: str, error: str) -> Outcome:
    return {"verdict": verdict, "error": error, "effects": [], "parameters": {}}


def outcomes(cases: Sequence[Case], jobs: int) -> Iterator[Outcome]:
    """Outcomes of the cases as they come; with one job, in this process."""
    if jobs == 1:
        yield from map(run_case, cases)
        return
    # a fresh interpreter each: MPI and compiled code do not like to be forked
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        try:
            for done in as_completed([pool.submit(run_case, case) for case in cases]):
                yield done.result()
        except BaseException:
            # otherwise an interrupt waits for all of them
            pool.shutdown(cancel_futures=True)
            raise


def run(
    seed: int, datasets: int, rows: Sequence[str], out: Path, jobs: int = 1, resume: bool = False
) -> list[Outcome]:
    """Outcomes of ``datasets`` of each row, kept in ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    journal = out / JOURNAL
    done = _done(journal, seed) if resume else {}
    if not resume:
        journal.write_text(json.dumps({"seed": seed}) + "\n")
    cases = [(seed, row, number) for number in range(datasets) for row in rows]
    missing = [case for case in cases if case[1:] not in done]
    for i, outcome in enumerate(outcomes(missing, jobs), start=1):
        done[outcome["row"], outcome["number"]] = outcome
        with journal.open("a") as file:
            file.write(json.dumps(outcome) + "\n")
        said = f"{outcome['verdict']} {' '.join(outcome['effects'])}"
        print(f"{i}/{len(missing)} {outcome['row']} {outcome['truth']}: {said}", file=sys.stderr)
    return [done[case[1:]] for case in cases]


def _done(journal: Path, seed: int) -> dict[tuple[str, int], Outcome]:
    """Finished outcomes of a journal; a line that an interruption cut is made again."""
    if not journal.exists():
        journal.write_text(json.dumps({"seed": seed}) + "\n")
        return {}
    lines = []
    for text in journal.read_text().splitlines():
        try:
            lines.append(json.loads(text))
        except json.JSONDecodeError:
            continue
    if not lines or lines[0].get("seed") != seed:
        raise SystemExit(f"{journal}: is of another seed")
    journal.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return {(line["row"], line["number"]): line for line in lines[1:]}


def main() -> None:
    """The command."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    asked.add_argument("--datasets", type=int, default=20, help="of each row")
    asked.add_argument("--seed", type=int, required=True)
    asked.add_argument("--rows", default=",".join(ROWS), help="separated by commas")
    asked.add_argument("--jobs", type=int, default=1, help="processes, one thread each")
    asked.add_argument("--out", type=Path, default=Path("results/blind"))
    asked.add_argument("--resume", action="store_true", help="keep what is finished in --out")
    given = asked.parse_args()
    rows = given.rows.split(",")
    for row in rows:
        if row not in ROWS:
            asked.error(f"--rows: {row} is none of {', '.join(ROWS)}")
    began = time.perf_counter()
    found = run(given.seed, given.datasets, rows, given.out, given.jobs, given.resume)
    lines = [str(line) for line in table(found)]
    without = [each for each in found if lost(each)]
    for each in without:
        last = each["error"].strip().splitlines()[-1]
        which = f"{each['row']} {each['number']} ({each['truth']})"
        lines.append(f"{each['verdict']}: {which}: {last}")
    wall = time.perf_counter() - began
    left_out = f"{len(without)} refused or not made"
    lines.append(f"{len(found)} datasets, {left_out}, seed {given.seed}, {wall:.0f} s")
    text = "\n".join(lines) + "\n"
    (given.out / "table.txt").write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
