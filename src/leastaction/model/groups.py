"""Differences between groups of trials: a payload, a temperature, other springs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np

from leastaction.data.trajectories import Trajectories
from leastaction.data.validation import listed
from leastaction.errors import InputError
from leastaction.estimation.groups import group_labels
from leastaction.identifiers import quoted
from leastaction.kinds import is_list, is_mapping
from leastaction.library import Kind
from leastaction.model.numbers import openness_of
from leastaction.model.term import ModelTerm, as_float
from leastaction.simulation.forecast import lengths_of
from leastaction.simulation.law import Law
from leastaction.simulation.results import ForecastResult

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["GroupDifference", "Grouped", "Groups"]

_Key = tuple[Kind, str]  # of a term: kind and expression


@dataclass(frozen=True)
class GroupDifference:
    """Difference of the coefficient of a term from that in the first group.

    Parameters
    ----------
    expression : str
        The term.
    group : str
    difference : float
        Coefficient in this group minus that in the first group, which may lack the term.
    standard_error : float
        NaN where it is not available.
    kind : {"lagrangian", "dissipation"}

    Raises
    ------
    InputError
        If a value is of the wrong type or not finite.

    Examples
    --------
    >>> payload = GroupDifference("theta_dot**2", "payload", 0.5, 0.01)
    >>> round(payload.lower, 3), round(payload.upper, 3), payload.z
    (0.48, 0.52, 50.0)
    """

    expression: str
    group: str
    difference: float
    standard_error: float = math.nan
    kind: Kind = "lagrangian"

    def __post_init__(self) -> None:
        for name in ("expression", "group"):
            value = getattr(self, name)
            if not isinstance(value, str) or not value.strip():
                raise InputError(
                    f"the {name} of a difference between groups is {quoted(value)}; expected text"
                )
        where = f"{quoted(self.written)}: the "
        if self.kind not in get_args(Kind):
            raise InputError(f"{where}kind is {quoted(self.kind)}; expected 'lagrangian' or 'dissipation'")
        error = as_float(self.standard_error, f"{where}standard error", missing=True, least=0.0)
        object.__setattr__(self, "difference", as_float(self.difference, f"{where}difference"))
        object.__setattr__(self, "standard_error", error)

    @property
    def written(self) -> str:
        """Term and group, for display."""
        return f"{self.expression} in {self.group}"

    @property
    def lower(self) -> float:
        """Lower end of the 95 % interval."""
        return self.as_term().lower

    @property
    def upper(self) -> float:
        """Upper end of the 95 % interval."""
        return self.as_term().upper

    @property
    def z(self) -> float:
        """Difference over standard error; NaN without one."""
        return self.as_term().z

    def as_term(self) -> ModelTerm:
        """The difference as a row of a table of terms."""
        return ModelTerm(self.expression, self.difference, self.standard_error, template=self.written)


@dataclass(frozen=True, eq=False)
class Groups:
    """The groups of trials of a discovery, and the differences between them.

    Parameters
    ----------
    names : sequence of str
        Names of the groups. The model has the coefficients of the first.
    differences : sequence of GroupDifference
        Differences from the first group, for a term in every other group or in none. Other terms have the
        same coefficient in all groups.
    covariance : array_like, shape (n_free + n_differences,) * 2, optional
        Covariance of the free coefficients, then of the differences.
    trials : sequence of str
        The group of each fitted trial; empty: not available.

    Raises
    ------
    InputError
        If there is only one group, a difference is of another or given twice, or a shape is wrong.

    Examples
    --------
    >>> groups = Groups(["empty", "payload"], [GroupDifference("cos(theta)", "payload", 9.81, 0.02)])
    >>> groups.terms
    ('cos(theta)',)
    """

    names: tuple[str, ...]
    differences: tuple[GroupDifference, ...] = ()
    covariance: np.ndarray | None = None
    trials: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = _names(self.names)
        differences = tuple(_difference(item, names) for item in self.differences)
        if len({(d.expression, d.kind, d.group) for d in differences}) < len(differences):
            raise InputError("groups has two differences of one term in one group; give each only once")
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "differences", differences)
        object.__setattr__(self, "trials", tuple(self.trials))
        for trial in self.trials:
            if trial not in names:
                raise InputError(f"groups has a trial of {quoted(trial)}; expected one of {listed(names)}")
        if self.covariance is not None:
            matrix = np.array(self.covariance, dtype=float)
            if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or len(matrix) < len(differences):
                raise InputError(f"groups has a covariance of shape {matrix.shape}; expected a square one")
            matrix.flags.writeable = False
            object.__setattr__(self, "covariance", matrix)

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms whose coefficients differ, each once."""
        return tuple(dict.fromkeys(d.expression for d in self.differences))

    def of(self, name: str) -> tuple[GroupDifference, ...]:
        """The differences of one group from the first.

        Raises
        ------
        InputError
            If there is no such group.
        """
        if name not in self.names:
            raise InputError(f"there is no group {quoted(name)}; the groups are {', '.join(self.names)}")
        return tuple(d for d in self.differences if d.group == name)

    def to_dict(self) -> dict[str, Any]:
        """Return the groups as JSON types."""
        differences = [
            {
                "expression": d.expression,
                "kind": d.kind,
                "group": d.group,
                "difference": d.difference,
                "standard_error": d.standard_error if math.isfinite(d.standard_error) else None,
            }
            for d in self.differences
        ]
        out: dict[str, Any] = {"names": list(self.names), "differences": differences}
        if self.trials:
            out["trials"] = list(self.trials)
        return out if self.covariance is None else {**out, "covariance": self.covariance.tolist()}

    @classmethod
    def from_dict(cls, document: Any, most: int) -> Groups:
        """Create groups from the output of `to_dict`, after checking all of it.

        Raises
        ------
        InputError
            If an entry is missing, unknown, of the wrong type, or there are more than `most` differences.
        """
        _check_entries(document, "groups", {"names", "differences"}, {"covariance", "trials"})
        trials = document.get("trials", [])
        if not all(map(is_list, (document["names"], document["differences"], trials))):
            raise InputError("groups: expected lists of names, of differences, and of trials")
        if max(len(document["names"]), len(document["differences"])) > most:
            raise InputError(f"groups has more than {most} entries")
        fields = {"expression", "kind", "group", "difference", "standard_error"}
        for item in document["differences"]:
            _check_entries(item, "groups: a difference", fields, set())
        differences = tuple(GroupDifference(**item) for item in document["differences"])
        matrix = _matrix(document.get("covariance"), most)
        return cls(tuple(document["names"]), differences, matrix, tuple(trials))


def _names(given: Iterable[object]) -> tuple[str, ...]:
    names = [name for name in given if isinstance(name, str) and name]
    if len(names) < 2 or len({*names}) < len([*given]):
        raise InputError(f"groups has the names {quoted(given)}; expected at least two different names")
    return tuple(names)


def _difference(item: object, names: tuple[str, ...]) -> GroupDifference:
    if not isinstance(item, GroupDifference):
        raise InputError(f"groups holds {quoted(item)}; expected a GroupDifference")
    if item.group not in names[1:]:
        raise InputError(
            f"groups has a difference in {quoted(item.group)}; expected one of {listed(names[1:])}"
        )
    return item


def _check_entries(value: Any, place: str, required: set[str], optional: set[str]) -> None:
    if not is_mapping(value) or not required <= {*value} <= required | optional:
        raise InputError(f"{place}: {quoted(value)}; expected an object with {', '.join(sorted(required))}")


def _matrix(rows: Any, most: int) -> np.ndarray | None:
    if rows is None:
        return None
    if not is_list(rows) or len(rows) > most or not all(is_list(r) and len(r) == len(rows) for r in rows):
        raise InputError("groups: the covariance is not a square list of lists")
    return np.array([[as_float(x, "groups: an entry of the covariance") for x in row] for row in rows])


class Grouped:
    """Methods of a model for groups of trials."""

    def of_group(self, name: str) -> LagrangianModel:
        """The model with the coefficients of one group of trials.

        Parameters
        ----------
        name : str
            One of ``groups.names``.

        Returns
        -------
        LagrangianModel
            For that group alone: with its coefficients, their errors and covariance, and without `groups` and
            diagnostics. The first group has the coefficients of the model itself.

        Raises
        ------
        InputError
            If the model was not found from groups, or there is no such group.

        Examples
        --------
        >>> from leastaction.model.model import LagrangianModel
        >>> groups = Groups(["empty", "payload"], [GroupDifference("x_dot**2", "payload", 0.25, 0.01)])
        >>> cart = LagrangianModel("x", [ModelTerm("x_dot**2", 0.5), ModelTerm("x**2", -2.0)], groups=groups)
        >>> cart.of_group("payload").lagrangian
        -2.0*x**2 + 0.75*x_dot**2
        """
        model = cast("LagrangianModel", self)
        if model.groups is None:
            raise InputError("the model was not found from groups of trials; give discover groups=...")
        return _of_group(model, model.groups, model.groups.of(name), name)

    @cached_property
    def _laws(self) -> dict[str, LagrangianModel]:
        return {}

    def of_trial(self, number: int) -> LagrangianModel:
        """The model with the coefficients of one of the trials of its discovery.

        Without groups, this is the model itself.
        """
        groups = cast("LagrangianModel", self).groups
        if groups is None or not groups.trials:
            return cast("LagrangianModel", self)
        name = groups.trials[number]
        if name not in self._laws:
            self._laws[name] = self.of_group(name)
        return self._laws[name]

    def forecast_groups(
        self,
        data: Trajectories,
        given: Mapping[str, object] | Iterable[object],
        lengths: tuple[float | None, float | None, float],
    ) -> ForecastResult:
        """Forecasts of several groups of trials, with the horizon, window and tolerance of `validate`."""
        model, labels = cast("LagrangianModel", self), group_labels(given, data)
        horizon, window = lengths_of(data, *lengths[:2])
        parts: list[ForecastResult] = []
        for name in dict.fromkeys(labels):
            law = model.of_group(name)
            own = data.select([k for k, label in enumerate(labels) if label == name])
            parts.append(law.validate(own, horizon, window=window, tolerance=lengths[2]))
        return parts[0].with_(parts[1:], data)

    @cached_property
    def _open_law(self) -> Law:
        """The law for simulations and forecasts, with the uncertainty of its coefficients."""
        model = cast("LagrangianModel", self)
        return Law.of(model.mechanics, openness_of(model))

    def own_trials(self, count: int) -> list[int]:
        """Indices of the trials, out of ``count``, that obey this model: all, or the first group."""
        groups = cast("LagrangianModel", self).groups
        if groups is None or not groups.trials:
            return list(range(count))
        return [k for k, name in enumerate(groups.trials[:count]) if name == groups.names[0]]


def _of_group(
    model: LagrangianModel, groups: Groups, differences: Sequence[GroupDifference], name: str
) -> LagrangianModel:
    own = [_key("lagrangian", term) for term in model.terms]
    own += [_key("dissipation", term) for term in model.dissipation]
    sizes = dict(zip(own, (*model.terms, *model.dissipation), strict=True))
    free = [key for key, term in sizes.items() if not term.known]
    units = np.eye(len(free) + len(groups.differences))
    rows = dict(zip(free, units, strict=False))
    for d in differences:
        key: _Key = (d.kind, d.expression)
        before = sizes.get(key, ModelTerm(d.expression, 0.0))
        sizes[key] = replace(before, coefficient=before.coefficient + d.difference, standard_error=math.nan)
        rows[key] = rows.get(key, 0.0) + units[len(free) + groups.differences.index(d)]
    # a term that is absent from the first group follows the others of its kind
    order = sorted(sizes, key=lambda key: key[0] == "dissipation")
    covariance = None
    if groups.covariance is not None:
        turn = np.array([rows[key] for key in order if key in rows])
        covariance = turn @ groups.covariance @ turn.T
        errors = np.sqrt(np.clip(np.diag(covariance), 0.0, None)).tolist()
        for key, error in zip((key for key in order if key in rows), errors, strict=True):
            sizes[key] = replace(sizes[key], standard_error=error)
    return replace(
        model,
        terms=tuple(sizes[key] for key in order if key[0] == "lagrangian"),
        dissipation=tuple(sizes[key] for key in order if key[0] == "dissipation"),
        covariance=covariance,
        diagnostics=None,
        groups=None,
        provenance={**model.provenance, "group": name},
    )


def _key(kind: Kind, term: ModelTerm) -> _Key:
    return kind, term.expression
