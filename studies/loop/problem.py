"""What the loop knows of a dataset: values, models that predict them, and no more.

Kinds of datasets (drops, tracks, forces, waves, falls) each build a `Problem`; detection,
attribution and verdict are written once and see only this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.effects.base import Parameter
from ...solver.errors import InputError


def undeclared(key: str, sigma: float | None) -> tuple[str, ...]:
    """A doubt where the uncertainty ``sigma`` under ``key`` of [measurement] is not declared."""
    if sigma is not None:
        return ()
    return (
        f"{key} is not declared: the errors are taken from how far the values of drops from one "
        "height, or of neighbours, differ; declare it, so that the size of what is left is tested",
    )


class Model(Protocol):
    """The baseline, or the baseline with one or several effects in it.

    ``effects`` names them. ``parameters`` are the baseline's free ones first, then the effects',
    each with bounds and the value at which it is absent. What differs by chance from group to group
    is integrated over ``weights`` (nodes,), which sum to one; one node where nothing does.
    """

    @property
    def effects(self) -> tuple[str, ...]: ...

    @property
    def parameters(self) -> tuple[Parameter, ...]: ...

    @property
    def weights(self) -> Array: ...

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., nodes, rows) for parameters (..., p).

        Defined within the parameters' bounds; smooth enough for finite differences.
        """
        ...


@runtime_checkable
class Scattering(Model, Protocol):
    """A model whose nodes of chance may have to be nearer each other where data are precise."""

    def finer(self, by: int) -> Model:
        """The same with ``by`` times as many nodes."""
        ...


@runtime_checkable
class Divisible(Model, Protocol):
    """A model that can predict some rows without all others."""

    def only(self, rows: NDArray[np.int64]) -> Model:
        """The same of these rows alone, which are all rows of their groups."""
        ...


@runtime_checkable
class Emulated(Model, Protocol):
    """A model that reads tables of simulations, which are only near them."""

    @property
    def possible(self) -> bool:
        """Whether its effects can act at once."""
        ...

    def simulated(self, theta: Array) -> Model:
        """The same as simulations have it at ``theta`` (p,); itself where its tables will do."""
        ...


@runtime_checkable
class Refinable(Model, Protocol):
    """A model whose effects may have more parameters, asked for where it does not hold without."""

    @property
    def refinement(self) -> Model | None:
        """The same with them; None where there are none."""
        ...


def refined_as(model: Model, parameters: int) -> Model:
    """The model, or its refinement where that is the one with so many parameters."""
    if len(model.parameters) < parameters and isinstance(model, Refinable):
        return model.refinement or model
    return model


@dataclass(frozen=True)
class Experiment:
    """A measurement that could be made next.

    ``models`` builds, for a model that was found, one with the same effects that predicts what it
    would give.
    """

    change: str
    models: Callable[[Model], Model]


@dataclass(frozen=True)
class Entry:
    """What a table itself seems to have wrong.

    ``kind`` is slip, repeated or exchanged. ``drops`` number the rows or the records. ``why`` gives
    the reason. ``numbers`` is how many numbers of each drop seem to be wrong.
    """

    kind: str
    drops: tuple[int, ...]
    why: str
    numbers: int = 1

    @property
    def rows(self) -> tuple[int, ...]:
        """The drops that are wrong: of those that are repeated, the first is not."""
        return self.drops[self.kind == "repeated" :]

    @property
    def slips(self) -> int:
        """How many numbers somebody wrote down wrongly."""
        return 0 if self.kind == "repeated" else len(self.drops) * self.numbers

    def words(self, one: str = "drop", several: str = "drops") -> str:
        """A sentence, in the words for what is numbered."""
        numbers = ", ".join(map(str, self.drops))
        return f"{several if len(self.drops) > 1 else one} {numbers}: {self.why}"


@dataclass(frozen=True)
class Problem:
    """A dataset, whitened by its declared noise, and the models that may explain it.

    ``values`` (rows,) are in units of their standard deviation; ``scale`` (rows,) turns a whitened
    residual back into ``unit`` (values of several units: each its own, ``quantity`` (rows,) names
    it; errors are told of the ``main`` one, the first where it is not said). ``group`` (rows,)
    numbers the drop, fall or pass that a row belongs to: groups are independent, rows of one group
    need not be. ``covariates`` (name: (rows,)) are what residuals
    are looked at against: height, speed, order, phase, time. ``candidates`` are all effects, alone,
    that a dataset of this kind can carry; ``combine`` builds the model of several at once.
    ``held`` are groups to be held out; where it is None, they are chosen by the seed.
    ``confirm``, where it is not None, gives whitened predictions of a model at its parameters by
    the 3-D model, for the rows of the groups asked for. ``warnings`` and ``left_aside``
    are sentences for the user: what deserves doubt, and which of the data are not used and why.
    ``bookkeeping`` is what the table has wrong, whose rows are left aside: those of the groups
    ``aside`` are still among these. Where groups are ``records``, two that hold the same numbers
    are one. ``lead`` is a doubt that comes before all that is found. ``with_sigma``, where it
    is not None, gives the same with errors of quantities that are so many times as large.
    """

    values: Array
    scale: Array
    unit: str
    quantity: NDArray[np.str_]
    group: NDArray[np.int64]
    covariates: Mapping[str, Array]
    baseline: Model
    candidates: Sequence[Model]
    combine: Callable[[tuple[str, ...]], Model]
    experiments: Sequence[Experiment] = ()
    held: tuple[int, ...] | None = None
    confirm: Callable[[Model, Array, NDArray[np.int64]], Array] | None = None
    confirm_why: str = ""
    sigma_declared: bool = True
    main: str = ""
    notes: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    left_aside: tuple[str, ...] = ()
    bookkeeping: tuple[Entry, ...] = ()
    with_sigma: Callable[[Mapping[str, float]], Problem] | None = None
    records: bool = False
    aside: tuple[int, ...] = ()
    lead: str = ""

    @property
    def groups(self) -> NDArray[np.int64]:
        """The groups that take part."""
        return np.setdiff1d(self.group, self.aside).astype(np.int64)

    def once(self) -> Problem:
        """The same with every record once: of those that hold the same numbers, the first."""
        alike: dict[bytes, list[int]] = {}
        for group in self.groups if self.records else ():
            alike.setdefault(self.values[self.group == group].tobytes(), []).append(int(group))
        twice = [tuple(each) for each in alike.values() if len(each) > 1]
        if not twice:
            return self
        why = "these records hold the same numbers; the first is kept"
        entries = tuple(Entry("repeated", each, why) for each in twice)
        again = (group for each in twice for group in each[1:])
        return replace(self, bookkeeping=(*self.bookkeeping, *entries), aside=(*self.aside, *again))

    @property
    def is_main(self) -> NDArray[np.bool_]:
        """Rows (rows,) of the main quantity."""
        return np.asarray(self.quantity == self.main_quantity)

    @property
    def main_quantity(self) -> str:
        """The name of the quantity that errors are told of."""
        return self.main or str(self.quantity[0])


def carried(kind: str, effects: Sequence[str], possible: Iterable[str]) -> tuple[str, ...]:
    """The ``effects`` of a model; InputError where data of this kind cannot carry one of them."""
    for name in effects:
        if name not in possible:
            known = ", ".join(possible)
            raise InputError(f"a {kind} dataset cannot carry {name}; {known} it can")
    return tuple(effects)
