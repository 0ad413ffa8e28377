"""The first sentences of a verdict: true of the numbers beside them, and about the right thing."""

from dataclasses import replace

import loop_toys as toys
import numpy as np
import pytest

from bristle.solver.effects.base import Parameter
from bristle.solver.effects.library import EFFECTS
from bristle.studies.close_loop.opening import (
    SEEN,
    few_data,
    on_few,
    opening,
    times,
    would_have_shown,
)
from bristle.studies.loop.finding import Finding, Interval, Verdict
from bristle.studies.loop.profile import Limit
from bristle.studies.loop.run import find


@pytest.fixture(scope="module")
def worn() -> Finding:
    return find(toys.problem(0, {"wear": 14.0})[0], seed=0)


@pytest.fixture(scope="module")
def clean() -> Finding:
    return find(toys.problem(2)[0], seed=2)


@pytest.mark.parametrize(
    ("p", "words"),
    [
        (0.42, "in 42 of 100 cases"),
        (0.098, "in 98 of 1,000 cases"),
        (0.0099, "once in 100 times"),
        (3.1e-6, "once in 320,000 times"),
        (1e-12, "less than once in a billion times"),
    ],
)
def test_a_probability_is_told_as_a_count(p, words):
    assert times(p) == words


def test_an_effect_is_told_with_its_size_and_what_it_does_for_held_out_data(worn):
    decades = {"decades": Interval(2.9, 2.5, 3.3, "decades")}
    verdict, chance, held = opening(replace(worn, parameters=decades))
    told = "drift with the order of drops (2.9 decades, 90 % interval 2.5 to 3.3)"
    assert told in verdict
    assert verdict.endswith("explains it.")
    assert chance.startswith("If nothing were missing")
    assert f"from {worn.held_out.rms_before:.2g} to {worn.held_out.rms_after:.2g} " in held


def test_the_error_is_told_of_the_quantity_that_the_effect_changes(worn):
    """A clock changes times alone: how well heights are predicted stays a matter of chance."""
    late = find(toys.problem(3, {"clock": 20.0}, candidates=("clock", "wear"))[0], seed=3)
    assert late.effects == ("clock",)
    held = opening(late)[-1]
    before, after = late.held_out.by_quantity["time"]
    assert after < 0.7 * before
    assert f"the error of time falls from {before:.2g} to {after:.2g} standard deviations" in held
    assert f"That of y1 is {late.held_out.rms_after:.2g} mm" in held
    assert "of time" not in opening(worn)[-1]


def test_nothing_missing_is_told_with_what_would_have_shown(clean):
    told = opening(clean)
    assert told[0].startswith("Nothing is missing that these data could show")
    assert len(told) == 2
    shown = {name for name, least in clean.detectable.items() if least is not None}
    assert len(would_have_shown(clean, toys.problem(2)[0])) == len(shown)


BETA = Parameter("beta_s", "s", 0.0, 1e-4, 2e-5, null=1.07e-5)
DOWN, UP = Limit(6.13e-6, 4.57e-6, False, False), Limit(2.3e-5, 1.23e-5, True, False)


@pytest.mark.parametrize(
    ("name", "first", "limits", "words"),
    [
        ("material_damping", BETA, (DOWN,), "from beta_s 6.1e-06 s down"),
        ("material_damping", BETA, (DOWN, UP), "from beta_s 6.1e-06 s down or 2.3e-05 s up"),
        (
            "stiffening_contact",
            Parameter("exponent", "", 1.0, 3.0, 1.5, null=1.0),
            (Limit(1.0082, 0.0082, True, False),),
            "from exponent 1.0082 up",
        ),
        (
            "scale_error",
            Parameter("relative", "", -0.2, 0.2, 0.01),
            (Limit(-0.03, 0.03, False, False), Limit(0.05, 0.05, True, False)),
            "from relative 0.05 on",
        ),
        (
            "scale_error",
            Parameter("relative", "", -0.2, 0.2, 0.01),
            (Limit(-0.03, 0.03, False, False),),
            "from relative -0.03 down",
        ),
        (
            "surface_slope",
            Parameter("std_deg", "°", 0.0, 8.0, 1.0),
            (Limit(0.008, 0.008, True, True),),
            "from less than std_deg 0.008 ° on",
        ),
    ],
)
def test_each_direction_is_told_from_where_on_it_shows(clean, name, first, limits, words):
    made = toys.problem(2)[0]
    model = made.candidates[0]
    model = replace(model, effects=(name,), parameters=(*made.baseline.parameters, first))
    found = replace(clean, limits={name: limits})
    (told,) = would_have_shown(found, replace(made, candidates=[model]))
    assert told == f"{EFFECTS[name].title} {words}"
    assert found.detectable == {name: min(each.size for each in limits)}


def test_effects_that_are_tied_are_all_told_and_so_is_which_go_together(worn):
    tied = replace(worn, verdict=Verdict.AMBIGUOUS, reported=(("wear",), ("adhesion", "wear")))
    told = opening(tied)[0]
    assert "drift with the order of drops; adhesion with drift with the order of drops." in told
    assert "do not tell which" in told
    begun = replace(
        tied,
        reported=(("wear",), ("session",)),
        remarks={("session",): {"session": "from drop 9 on"}},
    )
    assert opening(begun)[0].endswith("drops; a difference between sessions from drop 9 on.")


def test_each_of_two_effects_is_told_with_its_own_size(worn):
    """Wear and a session have a parameter of one name."""
    sizes = {
        "decades": Interval(-0.66, -0.69, -0.63, "decades per 100 drops"),
        "decades_3": Interval(0.17, 0.16, 0.18, "decades"),
    }
    names = ("wear", "session")
    told = opening(replace(worn, reported=(names,), parameters=sizes))[0]
    assert "drops (-0.66 decades per 100 drops, 90 % interval -0.69 to -0.63) with" in told
    assert "sessions (0.17 decades, 90 % interval 0.16 to 0.18)" in told


def test_what_no_test_shows_is_told_by_what_does(worn):
    otherwise = replace(worn, verdict=Verdict.UNKNOWN, noticed="outliers lie side by side")
    told = opening(otherwise)
    assert told[0].startswith("Outliers lie side by side, and no effect")
    assert told[1].startswith("The tests of the fitted data alone do not show it")


@pytest.mark.parametrize(
    ("shape", "nats", "words"),
    [
        ("settling in the order", 30.0, "The first of the data are off"),
        ("waves in the order", 30.0, "What the model leaves rises and falls with the order"),
        ("any function of height", 30.0, "What the model leaves changes with the height"),
        ("noise some 2.2 times as wide as is declared", 30.0, "The data are off in one range"),
        ("settling in the order", 1.0, "The data are off in one range of the height"),
    ],
)
def test_what_is_seen_is_the_likeliest_shape(worn, shape, nats, words):
    """The least p-value may be that of any shape which looks a little like it."""
    plain = replace(worn.evidences[0], log_evidence=-100.0)
    found = replace(
        worn,
        verdict=Verdict.UNKNOWN,
        statistic="band of height",
        evidences=(plain,),
        shape=shape,
        unlisted=nats - 100.0,
    )
    assert opening(found)[0].startswith(words)
    scattered = replace(found, statistic="scatter with height")
    assert ("scatter more and more" in opening(scattered)[0]) == ("wide" in shape or nats < 3.0)
    if "wide" in shape:
        told = opening(replace(found, statistic="wear"))[0]
        assert told.startswith("The data lie farther from the model than their errors allow")


def test_every_test_of_the_family_has_its_words(worn, clean):
    for found in (worn, clean):
        for each in found.tests:
            start = [name for name in SEEN if each.name.startswith(name)]
            assert start or each.name in found.needed_d, each.name


def test_few_drops_are_told_what_they_can_and_cannot_show():
    made = toys.problem(3, drops=6, quantities=1)[0]
    found = find(made, seed=0)
    few = few_data(found, made, "drops")
    assert few["groups"] == "6 drops"
    shown = {name for name, least in found.detectable.items() if least is not None}
    assert len(few["can_show"]) == len(shown)
    assert len(few["can_show"]) + len(few["cannot_show"]) == len(made.candidates)
    told = on_few(few)
    assert told[0].startswith("Only 6 drops")
    assert set(few["can_show"]) < set(told)
    assert few_data(found, toys.problem(2)[0], "drops") is None


def test_a_record_that_is_there_twice_counts_once():
    made = toys.problem(2)[0]
    again = np.where(made.group == 7, 3, made.group)  # what no. 7 reads is what no. 3 reads
    twice = replace(made, values=made.values.copy(), records=True)
    twice.values[made.group == 7] = made.values[made.group == 3]
    once = twice.once()
    assert [(each.kind, each.drops) for each in once.bookkeeping] == [("repeated", (3, 7))]
    assert np.array_equal(once.groups, np.unique(again))
    assert replace(twice, records=False).once().bookkeeping == ()


def test_what_is_known_beforehand_is_doubted_only_where_the_data_press_against_it(clean):
    """A force sensor is good to half a per cent, and most data tell no more of it."""
    gain = Parameter("gain", "", 0.995, 1.005, 1.0, null=1.0, why="class 0.5")
    stiff = Parameter("kn", "N/m", 1.0, 100.0, 10.0, null=10.0)
    of = replace(clean, model=replace(clean.model, parameters=(stiff, gain)))
    both = ("kn", "gain")
    loose = replace(of, at_bounds=both, unidentified=both).all_warnings()
    assert loose == [
        "at an end of the range that was searched: kn",
        "these data do not determine: kn",
    ]
    pressing = replace(of, at_bounds=("gain",), unidentified=())
    assert pressing.all_warnings() == []
    (pressed,) = replace(pressing, verdict=Verdict.UNKNOWN).all_warnings()
    assert pressed.startswith(
        "gain lies on a bound, and may be 0.995 to 1.005 only (class 0.5): if"
    )


def test_what_cannot_be_leads(worn):
    doubt = "y1_mm exceeds y0_mm in 48 of 48 drops"
    assert (
        opening(replace(worn, problem=replace(worn.problem, lead=doubt)))[0]
        == f"Before all: {doubt}."
    )
