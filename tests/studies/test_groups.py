"""Groups of ranks compute each case once, with the results that one rank has."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import mpirun
from hostile import refused
from hypothesis import given
from hypothesis import strategies as st

from bristle.studies.running.groups import BUILDING_STEPS, Load, best_sizes, deal, group_sizes

LOADS = st.lists(
    st.builds(
        Load, st.floats(1.0, 1e4), st.integers(1_000, 5_000_000), st.sampled_from(["a", "b", "c"])
    ),
    min_size=1,
    max_size=30,
)
SIZES = st.lists(st.integers(1, 4), min_size=1, max_size=6)


@given(st.integers(1, 64), st.integers(1, 64))
def test_every_rank_is_in_a_group_and_groups_differ_by_one(ranks, per_case):
    sizes = group_sizes(ranks, per_case)
    assert sum(sizes) == ranks
    assert max(sizes) - min(sizes) <= 1
    assert min(sizes) >= min(per_case, ranks)


@given(LOADS, SIZES)
def test_every_case_is_dealt_once(loads, sizes):
    hands, _ = deal(loads, sizes)
    assert len(hands) == len(sizes)
    assert sorted(i for hand in hands for i in hand) == list(range(len(loads)))


@given(LOADS, st.integers(1, 8))
def test_equal_groups_end_within_graham_s_bound(loads, groups):
    # any schedule of a list ends within 2 - 1/m times the least; building may be repeated, so
    # the least is taken with every case building for itself
    _, end = deal(loads, [1] * groups)
    work = [load.steps + BUILDING_STEPS for load in loads]
    assert end <= sum(work) / groups + max(work) * (1 - 1 / groups) + 1e-6


def test_many_cases_take_a_rank_each_and_one_takes_all():
    one = [Load(100.0, 50_000, "a")]
    assert best_sizes(one, 4) == [4]
    assert best_sizes(one * 200, 4) == [1, 1, 1, 1]


def test_large_bodies_are_spread_over_ranks_for_their_memory():
    large = [Load(100.0, 900_000, "a")] * 200
    assert best_sizes(large, 4) == [2, 2]


def test_a_body_is_built_in_as_few_groups_as_pays():
    loads = [Load(10.0, 50_000, body) for body in "ab" for _ in range(5)]
    hands, _ = deal(loads, [1, 1])
    assert sorted(map(sorted, hands)) == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]


CODE = """
import json
from mpi4py import MPI

from bristle.studies.inputs.config import DropInputs
from bristle.studies.reproduce.campaign import compute
from bristle.studies.running.cases import CaseSession

small = dict(cells=(1, 2, 12), length_m=0.02, write_fields=False, until="impact")
cases = [
    DropInputs(model=model, kn_N_m=kn, its_s=its, **small)
    for model in ("beam", "reduced", "solid")
    for its in (1e-6, 2e-6)
    for kn in ((1e6, 4e6) if its == 1e-6 else (2e6,))
]

def computed(comm, per_case):
    with CaseSession(comm) as session:
        found = compute(cases, session, ranks_per_case=per_case)
    return comm.rank == 0 and [
        (case.model.value, found[case].peak_force_N, found[case].contact_time_s) for case in cases
    ]

tables = [computed(MPI.COMM_WORLD, per_case) for per_case in (3, 2, 1, None)]
if MPI.COMM_WORLD.rank == 0:
    print(json.dumps([*tables, computed(MPI.COMM_SELF, 1)]))
"""


@pytest.mark.serial
def test_results_are_the_same_whatever_the_groups():
    """Three ranks together; as groups of 2 and 1 of three cases, uneven both ways; each alone; as
    the program sees fit; and one rank without others. Ranks that build a reduced solid together
    and meet in different cases would wait for each other, or take each other's."""
    done = mpirun(3, "-c", CODE)
    assert done.returncode == 0, done.stderr
    together, *others = json.loads(done.stdout)
    for grouped in others:
        for mine, theirs in zip(grouped, together, strict=True):
            assert mine[0] == theirs[0]
            np.testing.assert_allclose(mine[1:], theirs[1:], rtol=1e-9)
    for grouped in (others[0], others[2]):  # what has few unknowns is a matter of one rank
        assert [row for row in grouped if row[0] != "solid"] == together[:6]


LONE = """
import sys
from mpi4py import MPI
import click
from bristle.solver.errors import ComputationError

from bristle.studies.inputs.config import DropInputs
from bristle.studies.command.ending import run
from bristle.studies.running import groups, parallel
from bristle.studies.running.cases import CaseSession
from bristle.studies.running.groups import run_cases

if sys.argv[1] == "one":  # nobody else comes
    groups.GRACE_S = parallel.GRACE_S = 0.5

@click.command()
def lone():
    def work(session, case):
        if case.kn_N_m == 2e6 and (sys.argv[1] == "all" or session.comm.rank == 1):
            raise ComputationError("no solution")
        session.comm.Barrier()

    cases = [DropInputs(model="solid", cells=(1, 2, 12), kn_N_m=kn) for kn in (1e6, 2e6, 3e6, 4e6)]
    with CaseSession(MPI.COMM_WORLD) as session:
        run_cases(session, cases, work, lambda i, found: None, 2)

sys.exit(run(lone, []))
"""


@pytest.mark.serial
@pytest.mark.parametrize("who", ["all", "one"])
def test_a_case_that_fails_ends_the_job(who):
    done = mpirun(3, "-c", LONE, who)
    assert done.returncode == 1
    assert done.stderr.count("bristle: error: ") == 1
    assert "no solution" in done.stderr


@pytest.mark.serial
def test_the_paper_is_not_begun_with_more_ranks_per_case_than_there_are(tmp_path):
    said = refused("reproduce", "--ranks-per-case", "2", "--out", tmp_path / "out")
    assert "--ranks-per-case: there is 1 rank, not 2" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.serial
def test_more_ranks_per_case_than_ranks_is_wrong_input():
    arguments = ("--models", "solid", "--cells", "1", "2", "12", "--kn", "2e6", "--heights", "0.05")
    done = mpirun(2, "-m", "bristle.studies.sweep", *arguments, "--ranks-per-case", "3")
    assert done.returncode == 2
    assert "bristle: error: --ranks-per-case: there are 2 ranks, not 3\n" in done.stderr
