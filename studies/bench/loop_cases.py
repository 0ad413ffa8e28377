"""How often does the loop name what is missing, on datasets whose truth it does not see?

Each row of the table is a kind of dataset, made by `synth` with the reduced solid and read by the
loop with the beam. Every dataset is a case with a seed of its own, so cases can be dealt out over
ranks, and a run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...solver.bodies.modal import ModalBody
from ...solver.bristle import Array
from ...solver.effects.base import Effect
from ...solver.effects.library import EFFECTS
from ..loop.drop_model import effect_at
from ..loop.drops import drops_problem
from ..loop.problem import Model, Problem
from ..loop.run import find
from ..loop.sizes import clean, d_beyond, value_for, values_beyond
from ..synth import Made, Noise, Recipe, Strange, make, read_made
from .loop_ideal import Ideal, ideal_set
from .loop_rivals import rivals

# Effects that drops with contact times and forces can carry and show.
NAMED = tuple(
    name
    for name, effect in EFFECTS.items()
    if "drops" in effect.kinds and name not in ("air_drag", "lateral_inertia")
)
PAIR_D = 8.0
KN_N_M = (1e6, 4e6)


@dataclass(frozen=True)
class Row:
    """A kind of dataset: how many effects of which size, listed or not, and which noise.

    ``apart``: all drops of one height are held out instead of some of every height. ``beyond``: two
    effects have their size together, beyond what any single one explains of both; nothing scatters.
    """

    name: str
    listed: int = 0
    d: float = 0.0
    unlisted: bool = False
    noise: Noise = Noise.GAUSSIAN
    apart: bool = False
    beyond: bool = False


ROWS = (
    Row("clean"),
    Row("clean, heavy-tailed noise", noise=Noise.HEAVY),
    Row("clean, outliers", noise=Noise.OUTLIERS),
    Row("clean, autocorrelated noise", noise=Noise.CORRELATED),
    Row("one effect, d = 8", listed=1, d=8.0),
    Row("one effect, d = 16", listed=1, d=16.0),
    Row("unlisted, d = 8", d=8.0, unlisted=True),
    Row("unlisted, d = 16", d=16.0, unlisted=True),
    Row("two effects, d = 8 each", listed=2, d=PAIR_D),
    Row("one effect, d = 16, one height held out", listed=1, d=16.0, apart=True),
    Row("two effects, d = 8 beyond any one", listed=2, d=PAIR_D, beyond=True),
)


@dataclass(frozen=True)
class Case:
    """One dataset of a row."""

    row: Row
    number: int

    @property
    def seed(self) -> int:
        return 1000 * (1 + ROWS.index(self.row)) + self.number


@dataclass(frozen=True)
class Outcome:
    """What was said of a case, and what is true. Errors of held-out drops are in mm.

    ``ideal``: the mean size of an ideal reader's set and how often it holds the truth, for one
    effect that is listed.
    """

    row: str
    number: int
    truth: tuple[str, ...]
    values: tuple[float, ...]
    d: float
    verdict: str
    effects: tuple[str, ...]
    together: tuple[tuple[str, ...], ...]
    same: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    p_value: float
    left: float
    covered: tuple[bool, ...]
    before: float | None
    after: float | None
    oracle: float | None
    rivals: dict[str, str]
    wall_s: float
    ideal: Ideal | None


def run_case(case: Case, body: ModalBody) -> Outcome | None:
    """Make the case's dataset, run the loop and its rivals on it; None where no size fits."""
    rng = np.random.default_rng([case.seed, 7])
    low, high = np.log(KN_N_M)
    recipe = Recipe(
        kn_N_m=float(np.exp(rng.uniform(low, high))), noise=case.row.noise, seed=case.seed
    )
    sized = _sized(case, recipe, body, rng)
    if sized is None:
        return None
    recipe, d = sized
    made = make(recipe, body)
    started = time.perf_counter()
    problem = _problem(case, made)
    found = find(problem, seed=case.seed)
    wall = time.perf_counter() - started
    truth = tuple(effect.name for effect in recipe.effects)
    values = tuple(effect.values()[0] for effect in recipe.effects)
    same = {name for group in found.classes for name in group if set(group) & set(truth)}
    held = found.held_out
    oracle = None
    if held is not None:
        rows = np.searchsorted(np.unique(problem.group), held.groups)
        misses = made.measured[rows, 1] - _told(made.true[rows], made.measured[rows])
        oracle = 1e3 * float(np.sqrt(np.mean(misses**2)))
    return Outcome(
        row=case.row.name,
        number=case.number,
        truth=truth,
        values=values,
        d=d,
        verdict=str(found.verdict),
        effects=found.effects,
        together=found.together,
        same=tuple(sorted(same | set(truth))),
        classes=found.classes,
        p_value=found.p_value,
        left=found.open_set_p_value,
        covered=_covered(recipe, found.parameters, found.model_effects),
        before=None if held is None else held.rms_before,
        after=None if held is None else held.rms_after,
        oracle=oracle,
        rivals=rivals(problem, case.seed),
        wall_s=wall,
        ideal=ideal(case, recipe, problem),
    )


def ideal(case: Case, recipe: Recipe, problem: Problem) -> Ideal | None:
    """The ideal reader's set, see `loop_ideal`; None but for one effect that is listed."""
    if case.row.listed != 1:
        return None
    kn, effect = np.array([recipe.kn_N_m]), recipe.effects[0]
    data, base = clean(problem, kn, case.seed)
    theta = np.append(kn, effect.values()[0])
    model = _model(problem, effect.name)
    return ideal_set(problem, data, base, model, theta, case.row.d, case.seed)


def _problem(case: Case, made: Made) -> Problem:
    """What the loop is given of a made dataset."""
    problem = drops_problem(read_made(made))
    if not case.row.apart:
        return problem
    height = np.random.default_rng([case.seed, 8]).choice(made.recipe.heights_m)
    middle = problem.covariates["height"]
    near = np.abs(middle - height) == np.min(
        [np.abs(middle - each) for each in made.recipe.heights_m], axis=0
    )
    return replace(problem, held=tuple(int(group) for group in np.unique(problem.group[near])))


def _told(true: Array, measured: Array) -> Array:
    """The height after (drops,) that the truth gives for the height before as it was read."""
    return np.asarray(true[:, 1] / true[:, 0] * measured[:, 0])


def _covered(recipe: Recipe, parameters: Any, effects: Sequence[str]) -> tuple[bool, ...]:
    """Whether intervals hold the truth, where the right effects were reported."""
    if set(effects) != {effect.name for effect in recipe.effects} or recipe.strange is not None:
        return ()
    true = {"kn_N_m": recipe.kn_N_m}
    for effect in recipe.effects:
        true[effect.parameters[0].name] = effect.values()[0]
    return tuple(
        bool(parameters[name].low <= value <= parameters[name].high)
        for name, value in true.items()
        if name in parameters
    )


def _sized(
    case: Case, recipe: Recipe, body: ModalBody, rng: np.random.Generator
) -> tuple[Recipe, float] | None:
    """The recipe with effects of the row's size in it, and that size."""
    row = case.row
    if not row.d:
        return recipe, 0.0
    plain = make(recipe, body)
    problem = _problem(case, plain)
    data, base = clean(problem, np.array([recipe.kn_N_m]), case.seed)
    if row.unlisted:
        return _strange(case, recipe, problem, data, base, rng)
    names = list(rng.permutation(NAMED))
    if row.listed == 1:  # every effect in its turn
        names = [NAMED[case.number % len(NAMED)]]
    chosen: list[Effect] = []
    for name in names:
        model = _model(problem, name)
        clash = EFFECTS[name].place in [each.place for each in chosen]
        clash |= row.beyond and np.asarray(model.weights).size > 1
        value = None if clash else value_for(data, base, model, row.d, int(rng.integers(2)))
        if value is not None:
            chosen.append(effect_at(name, value))
        if len(chosen) < row.listed:
            continue
        if not row.beyond:
            return replace(recipe, effects=tuple(chosen)), row.d
        one, two = ((effect.name, effect.values()[0]) for effect in chosen)
        pair, alone = (one[0], two[0]), (one[1], two[1])
        found = values_beyond(problem, data, base, pair, alone, row.d)
        if found is not None:
            effects = tuple(map(effect_at, pair, found))
            return replace(recipe, effects=effects), row.d
        chosen.pop()
    return None


def _strange(
    case: Case, recipe: Recipe, problem: Problem, data: Any, base: Any, rng: np.random.Generator
) -> tuple[Recipe, float] | None:
    """An unlisted effect of the strength whose share beyond all listed ones has the row's size."""
    strange = tuple(Strange.__members__.values())[case.number % len(Strange)]
    sign = float(rng.choice([-1.0, 1.0]))
    strength = 0.02
    for _ in range(4):
        trial = replace(recipe, strange=strange, strength=sign * strength)
        shift = _shift(problem, trial)
        d = d_beyond(problem, data, base, shift)
        if d < 1e-6:
            return None
        if abs(d / case.row.d - 1.0) < 0.02:
            break
        strength = min(strength * case.row.d / d, 0.5)
    return replace(recipe, strange=strange, strength=sign * strength), d


def _shift(problem: Problem, recipe: Recipe) -> Array:
    """What the unlisted effect changes in whitened rows."""
    from ..synth import pattern

    model: Any = problem.baseline
    plain = model.measured(np.array([recipe.kn_N_m]))[0]
    changed = plain.copy()
    changed[:, 0] *= 1.0 + recipe.strength * pattern(recipe.strange, model.drops.y0_m)
    return np.asarray(np.einsum("dqr,dr->dq", model.whiten, changed - plain).ravel())


def _model(problem: Problem, name: str) -> Model:
    return next(each for each in problem.candidates if each.effects == (name,))
