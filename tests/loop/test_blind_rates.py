"""The loop's verdicts on blind datasets: what cannot be chance, and in a campaign the rates."""

import json

import blind_loop
import pytest
from blind.make import ROWS, make
from blind.table import exact, explained, table

from bristle.studies.loop.heldout import split
from bristle.studies.loop.kinds.drops.problem import read_problem
from bristle.studies.loop.profile import profile
from bristle.studies.loop.sample import sample
from bristle.studies.loop.search import fit_baseline, fit_candidate

pytestmark = pytest.mark.serial
SEED = 20240
# Rates are asserted with the slack of a binomial: nothing that 99.9 % of draws would pass fails.
CAMPAIGN, LEVEL = 30, 0.998


@pytest.mark.campaign
@pytest.mark.timeout(1800)  # where no table is there yet, and others work beside it
def test_what_is_grossly_wrong_is_not_adequate_and_data_with_nothing_in_them_are(tmp_path):
    """At 16 sigma and more neither is chance; a p-value of data that lack nothing may be small
    once in a million times."""
    gross = blind_loop.run_case((SEED, "gross", 0), tmp_path / "gross")
    assert gross["d"] > 16.0
    assert gross["verdict"] == "unknown" or explained(gross), gross["error"]
    clean = blind_loop.run_case((SEED, "clean", 0), tmp_path / "clean")
    assert clean["verdict"] != "refused", clean["error"]
    assert clean["detection"]["p_value"] > 1e-6


def test_a_contact_that_yields_in_few_drops_is_fitted_where_it_begins_to(tmp_path):
    """A fifth of the drops yield. From starts at few amounts the fit went to no effect, 179 N."""
    make(83776214, "listed16", 24).write(tmp_path)
    problem = read_problem(tmp_path)
    (yields,) = (each for each in problem.candidates if each.effects == ("plastic_contact",))
    for seed in range(3):
        data = sample(problem, split(problem, seed)[0])
        base = fit_baseline(data, problem.baseline)
        _, yield_N = fit_candidate(data, base, profile(data, base, yields)).fitted.theta
        assert 36.0 < yield_N < 40.0


def test_a_journal_is_taken_up_where_it_was_cut(tmp_path, monkeypatch):
    asked = []

    def fake(case):
        asked.append(case)
        return {"row": case[1], "number": case[2], "truth": "", "verdict": "unknown", "effects": []}

    monkeypatch.setattr(blind_loop, "run_case", fake)
    first = blind_loop.run(1, 2, ["clean", "noise"], tmp_path)
    journal = tmp_path / blind_loop.JOURNAL
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join(lines[:3]) + "\n" + lines[3][:10])
    asked.clear()
    again = blind_loop.run(1, 2, ["clean", "noise"], tmp_path, resume=True)
    assert again == first
    assert asked == [(1, "clean", 1), (1, "noise", 1)]
    assert next(json.loads(line) for line in journal.read_text().splitlines()) == {"seed": 1}
    with pytest.raises(SystemExit, match="another seed"):
        blind_loop.run(2, 2, ["clean"], tmp_path, resume=True)


@pytest.mark.campaign
@pytest.mark.timeout(6 * 3600)
def test_rates_over_many_datasets(tmp_path):
    """Every target of the table, each row's share with its exact interval at 99.8 %."""
    found = blind_loop.run(SEED, CAMPAIGN, list(ROWS), tmp_path, jobs=2)
    assert not [each["error"] for each in found if each["verdict"] == "refused"]
    missed = []
    for line in table(found):
        least, most = line.bounds
        low, high = line.value, line.value
        if line.low == line.low:
            low, high = exact(line.count, line.of, LEVEL)
        if low > most or high < least:
            missed.append(str(line))
    assert not missed, "\n".join(missed)
