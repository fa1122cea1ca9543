r"""Constraints between points that are tracked in a plane, and the coordinates that remain.

Points of rigid bodies obey equations of degree one (a slider) or two (a rod):

.. math:: n \cdot p = c, \qquad |p - a|^2 = r^2, \qquad |p_j - p_i|^2 = r^2 .

Each is a combination v of monomials of the tracks that does not vary: without noise, vᵀSv = 0 for their
covariance S. Noise adds a known matrix N to S. The constraint is the solution of S v = λ N v with the least
λ. It is consistent, while the v of least vᵀSv is not (Kukush, Markovsky & Van Huffel 2004, Comput. Stat. Data
Anal. 47:123). λ is the variance of the deviations over that which noise explains: it tends to one where a
constraint holds.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh

from leastaction.curve.knots import lay_knots
from leastaction.data.coerce import arranged
from leastaction.data.trajectories import Trajectories, Trajectory
from leastaction.errors import InputError
from leastaction.estimation.constraints import Body, Circle, Constraint, Linkage, circle_of, one_side, side_of
from leastaction.estimation.observations import RELATIVE_FLOOR
from leastaction.identifiers import check_coordinate_names, quoted

__all__ = ["Constraint", "Linkage", "linkage"]

_HOLDS = 9.0  # largest λ: tracks have systematic errors, too, here up to three times the noise
_CLEARER = 1.5  # factor of λ by which a circle has to beat a line, and a centre beside an anchor the anchor
_DEGREE = 5  # of the splines that tell the noise


class _Placed(NamedTuple):
    """Texts of both components, "" where constant; their mean values; whether it only translates."""

    texts: tuple[str, str]
    means: np.ndarray
    translates: bool


def linkage(trajectories: Trajectory | Iterable[Trajectory], bodies: Iterable[tuple[str, str]]) -> Linkage:
    """Find what ties tracked points in a plane, and propose coordinates with their measurement functions.

    Tested are: points at rest, points on a straight line, constant distances from a fixed point, from another
    point, or from a place beside another point that only translates, and links that turn together. Deviations
    may be up to three times those that noise explains. Where two rods tie a point, it is placed where their
    circles meet, as in a four-bar linkage; where a rod ties a point on a line, as in a slider-crank, it is
    placed where line and circle meet.

    Parameters
    ----------
    trajectories : Trajectory, Trajectories or iterable of Trajectory
        With the tracks as columns.
    bodies : iterable of (str, str)
        Columns of each point: horizontal, vertical.

    Returns
    -------
    Linkage

    Raises
    ------
    InputError
        If a body is not given by two columns of the data, or a column occurs twice.

    Notes
    -----
    Both columns must have the same unit, and the camera must stand still. Small motions cannot tell a circle
    from a line. A column with a measurement function is no coordinate; those of free points remain.

    Examples
    --------
    >>> import numpy as np
    >>> from leastaction import Trajectory
    >>> t = np.linspace(0.0, 6.0, 300)
    >>> angle, noise = np.cos(4.0 * t), 1e-3 * np.random.default_rng(0).standard_normal((300, 2))
    >>> track = 0.5 * np.column_stack([np.sin(angle), np.cos(angle)]) + noise
    >>> found = linkage(Trajectory(t, track, coordinates=["x", "y"]), [("x", "y")])
    >>> found.coordinates, round(found.constraints[0].radii[0], 2)
    (('theta',), 0.5)
    """
    data = Trajectories.coerce(trajectories)
    pairs: list[tuple[str, str]] = []
    for body in bodies:
        columns = check_coordinate_names(list(body))
        if len(columns) != 2:
            raise InputError(f"a body has the columns {quoted(columns)}; give two, horizontal and vertical")
        pairs.append((columns[0], columns[1]))
    names = [name for pair in pairs for name in pair]
    for name in names:
        if name not in data.coordinates or names.count(name) > 1:
            how = "is not a column of the data" if name not in data.coordinates else "occurs twice"
            raise InputError(f"bodies name {quoted(name)}, which {how}; give each point two columns")
    if not names:
        raise InputError("bodies is empty; give the two columns of each point")
    tracks = arranged(data.without_rates(), names)
    tracks = Trajectories([run.changed(forces=None) for run in tracks])
    values = np.concatenate([run.q for run in tracks])
    floor = RELATIVE_FLOOR * np.nanstd(values, axis=0)
    variance = np.maximum(lay_knots(tracks, _DEGREE).smooth.noise_std, floor) ** 2
    n = len(pairs)
    points = map(Body, pairs, np.split(values, n, axis=1), np.split(variance, n))
    return _Assembly(list(points)).found


class _Assembly:
    """Ties tracked points to the ground and to one another; those without a tie keep their columns.

    Attributes
    ----------
    found : Linkage
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self.found = Linkage()
        self._placed: dict[tuple[str, ...], _Placed] = {}
        self._bodies: dict[tuple[str, ...], Body] = {body.columns: body for body in bodies}
        self._turns: list[tuple[str, np.ndarray, float]] = []
        self._sign = 0.0
        self._taken = {name for body in bodies for name in body.columns}
        waiting = list(bodies)
        while waiting:
            # sliders last: a crank moves one, but with two solutions for each place of the slider
            order = [(k, late) for late in (False, True) for k in range(len(waiting))]
            at = next((k for k, late in order if self._tie(waiting[k], sliders=late)), None)
            if at is None:
                self._free(waiting[0])
            waiting.pop(at or 0)
        self.found = replace(self.found, measure=_once(self.found.measure))

    def _add(self, **more: Any) -> None:
        """Append to fields of the linkage."""
        longer = {name: getattr(self.found, name) + value for name, value in more.items()}
        self.found = replace(self.found, **longer)

    def _free(self, body: Body) -> None:
        self._add(coordinates=body.columns)
        self._placed[body.columns] = _Placed(body.columns, np.zeros(2), True)

    def _tie(self, body: Body, *, sliders: bool) -> bool:
        """Whether a constraint ties the point to the ground, or to a point with a place."""
        seen = body.track[np.isfinite(body.track).all(axis=1)]
        excess, normals = eigh(np.cov(seen.T), np.diag(body.variance))
        circles = self._circles(body)
        if excess[1] < _HOLDS:
            self._rest(body, seen, float(excess[1]))
        elif excess[0] < min([_HOLDS, *(_CLEARER * c.excess for c in circles if not c.anchor)]):
            ties = [(circle, self._spread(body, circle)) for circle in circles if circle.anchor]
            riding = next((circle for circle, (_, most) in ties if most < _HOLDS), None)
            rod = next((circle for circle, (least, _) in ties if least > _HOLDS), None)
            if riding is not None:
                self._ride(body, riding)
            elif sliders:
                self._slide(body, seen, normals[:, 0], float(excess[0]), rod)
        elif circles:
            self._turn(body, circles)
        return body.columns in self._placed

    def _circles(self, body: Body) -> list[Circle]:
        """Circles on which the point moves: about the ground, and about points with a place."""
        out = [circle_of((), body.track, body.variance, given=False)]
        for anchor, place in self._placed.items():
            if place.texts == ("", ""):
                continue
            other = self._bodies[anchor]
            away, variance = body.track - other.track, body.variance + other.variance
            found = circle_of(anchor, away, variance, given=True)
            if place.translates:  # its own mark need not be where the rod is fixed
                beside = circle_of(anchor, away, variance, given=False)
                found = beside if _CLEARER * beside.excess < found.excess else found
            out.append(found)
        return [circle for circle in out if circle.excess < _HOLDS]

    def _rest(self, body: Body, seen: np.ndarray, excess: float) -> None:
        still = Constraint("fixed", body.columns, deviation=excess**0.5)
        self._add(constraints=(still,), constant=body.columns)
        self._placed[body.columns] = _Placed(("", ""), seen.mean(axis=0), True)

    def _slide(
        self, body: Body, seen: np.ndarray, normal: np.ndarray, excess: float, rod: Circle | None
    ) -> None:
        """On a line: where a rod reaches it; else the column that moves more is the coordinate."""
        spread, means = seen.std(axis=0), seen.mean(axis=0)
        k = int(np.argmax(spread))
        column, other = body.columns[k], body.columns[1 - k]
        slope = -normal[k] / normal[1 - k]
        level = abs(slope) * spread[k] < body.variance[1 - k] ** 0.5  # the other column does not vary
        slope = 0.0 if level else slope
        side = 0.0 if rod is None else self._crank_side(body, rod, k, slope, means)
        self._add(loops=int(rod is not None and not side))
        rod = rod if side else None
        offset = self._number("offset", means[1 - k] - slope * means[k]) if rod or not level else ""
        tilt = "" if level else self._number("slope", slope)
        texts = ["", ""]
        if rod is None:
            texts[k] = column
            self._add(coordinates=(column,))
        else:
            texts[k] = self._on_rod(rod, k, side, offset, tilt)
            self._add(measure=(f"{column} = {texts[k]}",))
        anchors, radii = ((), ()) if rod is None else ((rod.anchor,), (rod.radius,))
        self._add(constraints=(Constraint("slides", body.columns, anchors, radii, excess**0.5),))
        if level:
            self._add(constant=(other,))
        else:
            texts[1 - k] = f"{offset} + {tilt}*" + (texts[k] if rod is None else f"({texts[k]})")
            self._add(measure=(f"{other} = {texts[1 - k]}",))
        self._placed[body.columns] = _Placed((texts[0], texts[1]), means, True)

    def _ride(self, body: Body, rod: Circle) -> None:
        """On the same slider as another point."""
        place, away = self._placed[rod.anchor], body.track - self._bodies[rod.anchor].track
        step, texts = np.nanmean(away, axis=0), ["", ""]
        for k, (column, text) in enumerate(zip(body.columns, place.texts, strict=True)):
            if text:
                texts[k] = f"{text} + {self._number('offset_' + 'xy'[k], float(step[k]))}"
                self._add(measure=(f"{column} = {texts[k]}",))
            else:
                self._add(constant=(column,))
        tie = Constraint("slides", body.columns, (rod.anchor,), (rod.radius,), rod.excess**0.5)
        self._add(constraints=(tie,))
        self._placed[body.columns] = _Placed((texts[0], texts[1]), place.means + step, True)

    def _spread(self, body: Body, circle: Circle) -> tuple[float, float]:
        """Least and largest variance of the place beside the anchor, over that of noise."""
        other = self._bodies[circle.anchor]
        away = body.track - other.track
        away = away[np.isfinite(away).all(axis=1)]
        least, most = eigh(np.cov(away.T), np.diag(body.variance + other.variance), eigvals_only=True)
        return float(least), float(most)

    def _crank_side(self, body: Body, rod: Circle, k: int, slope: float, means: np.ndarray) -> float:
        """On which side of the foot of its anchor the slider stays; 0 if it passes by."""
        to_anchor = self._bodies[rod.anchor].track + rod.centre - means
        across = to_anchor[:, 1 - k] - slope * to_anchor[:, k]
        along = body.track[:, k] - means[k] - to_anchor[:, k]
        return one_side(along - slope * across / (1.0 + slope**2))

    def _on_rod(self, rod: Circle, k: int, side: float, offset: str, tilt: str) -> str:
        """Where a line y = b + a x meets a circle of radius r about P, with D = P_y − b − a P_x:

        x = P_x + (a D ± √((1 + a²) r² − D²))/(1 + a²).
        """
        centre, r = self._centre(rod), self._number("length", rod.radius)
        sign = "+" if side > 0.0 else "-"
        across = f"({centre[1 - k]} - {offset}" + (f" - {tilt}*({centre[k]}))" if tilt else ")")
        if not tilt:
            return f"{centre[k]} {sign} sqrt({r}**2 - {across}**2)"
        square = f"(1 + {tilt}**2)"
        return f"{centre[k]} + ({tilt}*{across} {sign} sqrt({square}*{r}**2 - {across}**2))/{square}"

    def _turn(self, body: Body, circles: list[Circle]) -> None:
        """On one circle: with an angle of its own, or of another body; on two circles: where they meet."""
        first = circles[0]
        away = body.track - first.centre - (self._bodies[first.anchor].track if first.anchor else 0.0)
        self._sign = self._sign or (1.0 if np.nanmean(away[:, 1]) >= 0.0 else -1.0)
        turned = np.arctan2(away[:, 0], self._sign * away[:, 1])
        size = float(body.variance.mean()) / first.radius**2
        with_it = self._with_another(turned, size)
        side = side_of(body, circles, self._bodies)
        if with_it is not None:
            kind, angle, circles = "turns with", with_it, circles[:1]
        elif side and len(circles) > 1:
            kind, angle, circles = "closes", "", circles[:2]
        else:
            self._add(loops=int(len(circles) > 1))
            kind, angle, circles = "turns", self._name("theta"), circles[:1]
            self._add(coordinates=(angle,), angles=(angle,))
            self._turns.append((angle, turned, size))
        worst = max(c.excess for c in circles) ** 0.5
        anchors, radii = tuple(c.anchor for c in circles), tuple(c.radius for c in circles)
        texts = self._meeting(circles, side) if kind == "closes" else self._around(first, angle)
        functions = tuple(f"{column} = {text}" for column, text in zip(body.columns, texts, strict=True))
        self._add(constraints=(Constraint(kind, body.columns, anchors, radii, worst),), measure=functions)
        self._placed[body.columns] = _Placed(texts, np.zeros(2), False)

    def _with_another(self, turned: np.ndarray, size: float) -> str | None:
        """The angle of another body, with a constant beside it if there is one, if the two turn together."""
        for name, other, of_other in self._turns:
            apart = np.exp(1j * (turned - other))
            apart = apart[np.isfinite(apart)]
            offset = float(np.angle(apart.mean()))
            variance, noise = float(np.var(np.angle(apart * np.exp(-1j * offset)))), size + of_other
            if variance < _HOLDS * noise:
                return name if offset**2 < noise else f"{name} + {self._number('turn', offset)}"
        return None

    def _centre(self, circle: Circle) -> tuple[str, str]:
        """The centre of a circle as texts."""
        if not circle.anchor:
            return self._number("pivot_x", circle.centre[0]), self._number("pivot_y", circle.centre[1])
        place, out = self._placed[circle.anchor], ["", ""]
        for k, text in enumerate(place.texts):
            if not text:
                out[k] = self._number(f"pivot_{'xy'[k]}", float(place.means[k] + circle.centre[k]))
            elif circle.given:
                out[k] = text
            else:
                out[k] = f"{text} + {self._number('offset_' + 'xy'[k], float(circle.centre[k]))}"
        return out[0], out[1]

    def _around(self, circle: Circle, angle: str) -> tuple[str, str]:
        (x, y), length = self._centre(circle), self._number("length", circle.radius)
        sign = "+" if self._sign > 0.0 else "-"
        return f"{x} + {length}*sin({angle})", f"{y} {sign} {length}*cos({angle})"

    def _meeting(self, circles: list[Circle], side: float) -> tuple[str, str]:
        """Where two circles meet: P + a D + b D⊥, D = Q − P, a = ½ + (r² − s²)/2D², a² + b² = r²/D²."""
        (px, py), (qx, qy) = (self._centre(circle) for circle in circles)
        r, s = (self._number("length", circle.radius) for circle in circles)
        dx, dy = f"({qx} - ({px}))", f"({qy} - ({py}))"
        square = f"({dx}**2 + {dy}**2)"
        a = f"(1/2 + ({r}**2 - {s}**2)/(2*{square}))"
        b = f"sqrt({r}**2/{square} - {a}**2)"
        one, other = ("-", "+") if side > 0.0 else ("+", "-")
        return f"{px} + {a}*{dx} {one} {b}*{dy}", f"{py} + {a}*{dy} {other} {b}*{dx}"

    def _name(self, base: str) -> str:
        name, k = base, 1
        while name in self._taken:
            k += 1
            name = f"{base}{k}"
        self._taken.add(name)
        return name

    def _number(self, base: str, start: float) -> str:
        return f"{{{self._name(base)}={start:.6g}}}"


def _once(functions: Iterable[str]) -> tuple[str, ...]:
    """The functions with each start value at its first occurrence only."""
    given: set[str] = set()

    def shortened(found: re.Match[str]) -> str:
        name = found[1]
        text = f"{{{name}}}" if name in given else found[0]
        given.add(name)
        return text

    return tuple(re.sub(r"\{(\w+)=[^}]*\}", shortened, text) for text in functions)
