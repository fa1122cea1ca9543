"""The scikit-learn face of `discover`; scikit-learn is imported only with this module."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

try:
    from sklearn.base import BaseEstimator
    from sklearn.utils.metadata_routing import UNUSED
    from sklearn.utils.validation import check_is_fitted
except ImportError:
    raise ImportError(
        "SparseLagrangian needs scikit-learn; install it with: pip install 'leastaction[sklearn]'"
    ) from None

from leastaction.api import discover
from leastaction.data.coerce import gather, one_each
from leastaction.estimation.adam import AdamOptions
from leastaction.library import Library
from leastaction.simulation.forecast import ForecastResult
from leastaction.simulation.integrate import SimulationResult

if TYPE_CHECKING:
    from leastaction.model.model import LagrangianModel

__all__ = ["SparseLagrangian"]

# An error counts for at most this many standard deviations, or one lost forecast would outweigh all others.
_WORST = 10.0


class SparseLagrangian(BaseEstimator):
    """`discover` as a scikit-learn estimator.

    A sample is a trajectory. `fit` and `score` take a list of trajectories, and so do ``GridSearchCV`` and
    ``cross_val_score``, which then split trajectories, not rows. A trajectory is an array of measured
    coordinates or a `Trajectory`. The times are the second argument, in place of y, so they are split
    together with the coordinates. Pass known forces in a `Trajectory`.

    Parameters
    ----------
    library : Library or sequence of str, optional
        Candidates of L; by default those of `Library.mechanical` for the coordinates and angles.
    known, dissipation, method, angles, prescribed, degree, relevance, seed, shapes, options
        As for `discover`.
    coordinates : sequence of str, optional
        Names of the columns of the arrays given to `fit`; by default those of the library, or
        ``q1``, ``q2``, ... if it has none.
    horizon : float, optional
        Length of the forecasts that `score` makes, in seconds; by default as for
        `LagrangianModel.validate`.

    Attributes
    ----------
    model_ : LagrangianModel
        The model; ``model_.fit.status`` says whether it can be trusted.
    coef_ : ndarray, shape (n_terms,)
        Coefficients of the terms of L, then of the dissipation function.
    coordinates_ : tuple of str
    n_features_in_ : int
        Number of coordinates.
    t_ : float, ndarray or None
        The times shared by all trajectories of `fit`, for a `score` without times.

    Examples
    --------
    >>> from leastaction import systems
    >>> runs = systems.generate("single_pendulum", noise=0.01, trials=3, duration=4.0, seed=0)
    >>> pendulum = SparseLagrangian(["theta_dot**2", "cos(theta)", "sin(theta)", "theta_dot**4"])
    >>> pendulum.fit(list(runs)).model_.lagrangian
    0.5*theta_dot**2 + 9.8*cos(theta)
    >>> pendulum.predict([[0.1]]).round(2).tolist()
    [[-0.98]]
    >>> pendulum.score(list(runs)) > 0.99
    True

    Options by cross-validation over trajectories (arrays go with their times,
    ``search.fit(list_of_q, list_of_t)``):

    >>> from sklearn.model_selection import GridSearchCV
    >>> search = GridSearchCV(pendulum, {"degree": [4, 5]}, cv=3).fit(list(runs))
    >>> len(search.best_estimator_.model_.terms)
    2
    """

    # Only these names may be routed to the methods as metadata; q and the like are always given.
    __metadata_request__fit: ClassVar = {"q": UNUSED}
    __metadata_request__score: ClassVar = {"q": UNUSED}
    __metadata_request__predict: ClassVar = {"q": UNUSED, "qdot": UNUSED}

    def __init__(
        self,
        library: Library | Sequence[str] | None = None,
        known: Mapping[str, float] | None = None,
        dissipation: Iterable[str] = (),
        *,
        coordinates: Sequence[str] | None = None,
        method: str = "gauss-newton",
        angles: Sequence[str] | None = None,
        prescribed: Sequence[str] = (),
        degree: int | None = None,
        relevance: float = 0.05,
        seed: int = 0,
        shapes: Mapping[str, tuple[float, float]] | None = None,
        options: AdamOptions | Mapping[str, object] | None = None,
        horizon: float | None = None,
    ) -> None:
        self.library = library
        self.known = known
        self.dissipation = dissipation
        self.coordinates = coordinates
        self.method = method
        self.angles = angles
        self.prescribed = prescribed
        self.degree = degree
        self.relevance = relevance
        self.seed = seed
        self.shapes = shapes
        self.options = options
        self.horizon = horizon

    def fit(self, q: Any, t: Any = None, forces: Any = None) -> SparseLagrangian:
        """Find the Lagrangian.

        Parameters
        ----------
        q : array_like, shape (n_times, n_dof), or sequence of them, or of Trajectory
            Measured coordinates, NaN for missing samples. A list or tuple has one trajectory per entry; so
            has an array of shape (n_trajectories, n_times, n_dof).
        t : float, array_like of shape (n_times,), or sequence of them
            Times in seconds: the sampling interval, the common times of all trajectories, or the times of
            each. None if `q` contains Trajectory objects.
        forces : array_like of shape (n_times, n_dof), or sequence of them, optional
            Known generalised forces of all trajectories or of each (None: not driven).

        Returns
        -------
        SparseLagrangian
            The estimator itself.

        Raises
        ------
        InputError
            Wrong arguments (a ValueError).
        DataError
            The data cannot support any model (a ValueError).
        """
        names = self.coordinates
        if names is None and isinstance(self.library, Library):
            names = self.library.coordinates
        data = gather(q, t, forces, names)
        library = self.library
        if library is None:
            library = Library.mechanical(data.coordinates, self.angles or ())
        self.model_: LagrangianModel = discover(
            data,
            library,
            self.known,
            self.dissipation,
            method=self.method,
            angles=self.angles,
            prescribed=self.prescribed,
            degree=self.degree,
            relevance=self.relevance,
            shapes=self.shapes,
            seed=self.seed,
            options=self.options,
        )
        terms = (*self.model_.terms, *self.model_.dissipation)
        self.coef_: np.ndarray = np.array([term.coefficient for term in terms])
        self.coordinates_: tuple[str, ...] = self.model_.coordinates
        self.n_features_in_: int = self.model_.n_dof
        self.t_: float | np.ndarray | None = None
        if t is not None and not one_each(t):
            self.t_ = float(t) if np.ndim(t) == 0 else np.array(t, dtype=float)
        return self

    def predict(
        self,
        q: ArrayLike,
        qdot: ArrayLike | None = None,
        forces: ArrayLike | None = None,
        t: ArrayLike | None = None,
    ) -> np.ndarray:
        """Predict the accelerations of given states.

        Parameters
        ----------
        q : array_like, shape (..., n_dof)
        qdot : array_like, shape (..., n_dof), optional
            Zero by default: the acceleration from rest.
        forces : array_like, shape (..., n_dof), optional
        t : array_like, shape (...), optional
            Times in seconds, for a law that depends on time.

        Returns
        -------
        ndarray, shape (..., n_dof)
            q̈, as from `LagrangianModel.acceleration`. Use `simulate` for motions over time.
        """
        check_is_fitted(self)
        qdot = np.zeros(self.n_features_in_) if qdot is None else qdot
        return self.model_.acceleration(q, qdot, forces, t)

    def simulate(self, q0: ArrayLike, qdot0: ArrayLike, t: ArrayLike, forces: Any = None) -> SimulationResult:
        """Motion from a start, as `LagrangianModel.simulate`.

        Parameters
        ----------
        q0, qdot0 : array_like, shape (n_dof,)
        t : array_like, shape (n_times,)
        forces : array_like, shape (n_times, n_dof), or callable, optional
            Generalised forces at `t`, or ``forces(time) -> (n_dof,)``.

        Returns
        -------
        SimulationResult
        """
        check_is_fitted(self)
        return self.model_.simulate(q0, qdot0, t, forces)

    def score(self, q: Any, t: Any = None, forces: Any = None) -> float:
        """R² of forecasts of held-out trajectories, the mean over the coordinates.

        Forecasts over `horizon` seconds start at regular intervals along each trajectory, from the state that
        best fits the preceding samples (`LagrangianModel.validate`). R² = 1 − Σ error² / Σ deviation² over
        all forecast samples of a coordinate, with deviations from their mean: 1 is perfect, and 0 is no
        better than the mean. Errors are limited to ten standard deviations, also for forecasts that diverged
        or had no start, so the score is at least −99.

        Parameters
        ----------
        q, t, forces
            As for `fit`. Without `t`, the common times of the trajectories of `fit` are used.

        Returns
        -------
        float

        Raises
        ------
        InputError
            Wrong arguments, or trajectories too short for one forecast.
        """
        check_is_fitted(self)
        data = gather(q, t, forces, self.coordinates_, self.t_)
        return _forecast_r2(self.model_.validate(data, self.horizon))

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        tags.input_tags.three_d_array = True
        return tags


def _forecast_r2(result: ForecastResult) -> float:
    measured = np.concatenate([trace.measured for trace in result.traces])
    forecast = np.concatenate([trace.forecast for trace in result.traces])
    scores = []
    for m, f in zip(measured.T, forecast.T, strict=True):
        seen = np.isfinite(m)
        if not seen.any():
            continue
        deviation = m[seen] - m[seen].mean()
        limit = _WORST * np.sqrt(np.mean(deviation**2))
        error = np.nan_to_num(np.abs(f[seen] - m[seen]), nan=np.inf)
        error = np.minimum(error, limit)
        scores.append(1.0 - np.sum(error**2) / max(np.sum(deviation**2), np.finfo(float).tiny))
    return float(np.mean(scores))
