"""Constraints between tracked points as they are reported, and circles on which points move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

__all__ = ["Body", "Circle", "Constraint", "Linkage", "circle_of", "one_side", "side_of"]

_ONE_SIDE = 0.99  # share of samples on one side, for the solution of a loop to be a single one


@dataclass(frozen=True)
class Constraint:
    """A constraint that holds.

    Attributes
    ----------
    kind : {"fixed", "slides", "turns", "turns with", "closes"}
        At rest; on a line, with an anchor also on a circle about it; on a circle about the anchor; like that,
        at a constant angle to another body; on circles about two anchors.
    body : (str, str)
        Columns of the point.
    anchors : tuple of (str, str)
        Columns of the points to which it is tied; () for the ground.
    radii : tuple of float
        Distances from them.
    deviation : float
        Root mean square deviation over that which noise explains.
    """

    kind: str
    body: tuple[str, str]
    anchors: tuple[tuple[str, ...], ...] = ()
    radii: tuple[float, ...] = ()
    deviation: float = 1.0

    def __str__(self) -> str:
        body = "(" + ", ".join(self.body) + ")"
        about = [f"({', '.join(a)})" if a else "a fixed point" for a in self.anchors]
        tied = " and ".join(f"{r:.4g} from {a}" for r, a in zip(self.radii, about, strict=True))
        line = "moves along a straight line" + (f" and stays {tied}" if tied else "")
        said = {"fixed": "does not move", "slides": line, "turns": f"stays {tied}"}
        said |= {"turns with": f"stays {tied} and turns with another point", "closes": f"stays {tied}"}
        return f"{body} {said[self.kind]} (deviation {self.deviation:.2g} times the noise)"


@dataclass(frozen=True)
class Linkage:
    """Constraints between tracked points, and coordinates that fulfil them.

    Attributes
    ----------
    constraints : tuple of Constraint
        With ``kind``, ``body``, ``anchors``, ``radii``, and ``deviation`` (from the constraint, over noise).
    coordinates, angles : tuple of str
        Coordinates that remain, and those of them that are angles from the vertical.
    measure : tuple of str
        Measurement functions, with start values of the calibration numbers.
    constant : tuple of str
        Columns to leave out, because they do not move.
    loops : int
        Points with a constraint that these coordinates do not fulfil.
    """

    constraints: tuple[Constraint, ...] = ()
    coordinates: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()
    measure: tuple[str, ...] = ()
    constant: tuple[str, ...] = ()
    loops: int = 0

    @property
    def ties(self) -> list[str]:
        """What ties the points, in words."""
        lines = list(map(str, self.constraints))
        if self.loops:
            lines.append(f"{self.loops} more than the coordinates fulfil: the loop has no unique solution")
        return lines

    def __str__(self) -> str:
        lines = [*self.ties, f"coordinates: {', '.join(self.coordinates) or 'none'}"]
        lines += [f'--measure "{text}"' for text in self.measure]
        return "\n".join(lines + ([f"leave out: {', '.join(self.constant)}"] if self.constant else []))


class Body(NamedTuple):
    """A tracked point: (n_times, 2) samples, NaN where missing, and the variance of their noise."""

    columns: tuple[str, str]
    track: np.ndarray
    variance: np.ndarray


class Circle(NamedTuple):
    """A circle on which a point moves: about the ground, (), or another point.

    The centre is the place of the anchor plus ``centre``, which is zero if ``given``. ``excess`` is the
    variance of the deviations over that which noise explains.
    """

    anchor: tuple[str, ...]
    centre: np.ndarray
    radius: float
    excess: float
    given: bool


def circle_of(anchor: tuple[str, ...], track: np.ndarray, variance: np.ndarray, *, given: bool) -> Circle:
    """The circle that fits best, about a given centre at the origin or any other."""
    p = track[np.isfinite(track).all(axis=1)]
    shift = np.zeros(2) if given else p.mean(axis=0)
    unit = float(np.sqrt(np.mean((p - shift) ** 2)))
    p, noise = (p - shift) / unit, variance / unit**2
    mean, square = p.mean(axis=0), (p**2).mean(axis=0) - noise
    features = np.column_stack([(p**2).sum(axis=1), p])
    matrix = np.zeros((3, 3))
    matrix[0, 0] = 4.0 * square @ noise + 2.0 * noise @ noise
    matrix[0, 1:] = matrix[1:, 0] = 2.0 * mean * noise
    matrix[1:, 1:] = np.diag(noise)
    n = 1 if given else 3
    excess, vectors = eigh(np.cov(features.T)[:n, :n], matrix[:n, :n], subset_by_index=[0, 0])
    slopes: np.ndarray = np.zeros(2)
    slopes[: n - 1] = vectors[1:, 0] / vectors[0, 0]
    centre = -0.5 * slopes
    radius = np.sqrt(max(square.sum() + slopes @ mean + centre @ centre, 0.0))
    return Circle(anchor, centre * unit + shift, float(radius) * unit, float(excess[0]), given)


def side_of(body: Body, circles: Sequence[Circle], bodies: Mapping[tuple[str, ...], Body]) -> float:
    """On which side of the line between two anchors the point stays; 0 if it does not."""
    if len(circles) < 2:
        return 0.0
    first, second = (c.centre + (bodies[c.anchor].track if c.anchor else np.zeros(2)) for c in circles[:2])
    away, line = body.track - first, second - first + np.zeros_like(body.track)
    side: np.ndarray = line[:, 0] * away[:, 1] - line[:, 1] * away[:, 0]
    return one_side(side)


def one_side(values: np.ndarray) -> float:
    """The sign of nearly all finite values; 0 if they have both signs."""
    left = float(np.mean(values[np.isfinite(values)] > 0.0))
    return 1.0 if left > _ONE_SIDE else -1.0 if left < 1.0 - _ONE_SIDE else 0.0
