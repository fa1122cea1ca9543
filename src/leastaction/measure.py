"""Measurement functions that are often needed, as texts for ``discover(measure=...)``.

They are expressions like any other: print them, change them, or write your own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from leastaction.errors import InputError
from leastaction.identifiers import check_coordinate_names, quoted

if TYPE_CHECKING:
    from leastaction.data.trajectories import Trajectory
    from leastaction.estimation.linkage import Linkage

__all__ = ["Linkage", "camera", "imu", "linkage"]


def camera(angles: Sequence[str], markers: Sequence[tuple[str, str]]) -> list[str]:
    r"""Pixels of the ends of links in a row, seen by a camera that faces their plane.

    With absolute angles θ_k from the vertical, the end of link n is seen at

    .. math:: u_n = x_0 + \sum_{k \le n} l_k \sin(\theta_k + \delta), \qquad
              v_n = y_0 + \sum_{k \le n} l_k \cos(\theta_k + \delta).

    Parameters
    ----------
    angles : sequence of str
        From the pivot outwards, each measured from the vertical.
    markers : sequence of (str, str)
        Columns (right, down) of the end of each link, in pixels.

    Returns
    -------
    list of str
        Calibration numbers: the pivot ``{x0}``, ``{y0}``, the lengths ``{l1}``, ``{l2}``, … in pixels, and
        the angle ``{tilt}`` by which the camera is rolled.

    Raises
    ------
    InputError
        If there is not one marker for each angle, or a name is not allowed.

    Notes
    -----
    Perspective and distortion of a lens are not included. Lengths are known in pixels only: no law of motion
    tells the size of a pixel.

    Examples
    --------
    >>> camera(["theta"], [("u", "v")])
    ['u = {x0} + {l1}*sin(theta + {tilt})', 'v = {y0} + {l1}*cos(theta + {tilt})']
    """
    names = check_coordinate_names(list(angles))
    if len(markers) != len(names):
        raise InputError(f"{len(markers)} markers for {len(names)} angles; give one for the end of each link")
    out: list[str] = []
    sums = ["{x0}", "{y0}"]
    for k, (name, columns) in enumerate(zip(names, markers, strict=True), start=1):
        waves = (f"{{l{k}}}*{wave}({name} + {{tilt}})" for wave in ("sin", "cos"))
        sums = [f"{so_far} + {wave}" for so_far, wave in zip(sums, waves, strict=True)]
        out += [f"{column} = {total}" for column, total in zip(columns, sums, strict=True)]
    return out


def imu(
    angle: str, *, tangential: str | None = None, radial: str | None = None, gyroscope: str | None = None
) -> list[str]:
    r"""An inertial sensor on a link that swings about a fixed axis.

    At distance r from the axis, θ from the vertical, and in g = 9.81 m/s², it shows

    .. math:: r \ddot\theta + g \sin\theta + b_t, \qquad r \dot\theta^2 + g \cos\theta + b_r, \qquad
              \dot\theta + b_g.

    Parameters
    ----------
    angle : str
    tangential, radial, gyroscope : str, optional
        Columns in m/s², m/s² and rad/s; the radial axis points to the axis of rotation.

    Returns
    -------
    list of str
        Calibration numbers: ``{r}`` in metres, and a bias for each column, such as ``{acc_bias}``.

    Raises
    ------
    InputError
        If no column is given, or a name is not allowed.

    Examples
    --------
    >>> imu("theta", gyroscope="gyro")
    ['gyro = theta_dot + {gyro_bias}']
    """
    (name,) = check_coordinate_names([angle])
    shown = (
        (tangential, f"{{r}}*{name}_ddot + 9.81*sin({name})"),
        (radial, f"{{r}}*{name}_dot**2 + 9.81*cos({name})"),
        (gyroscope, f"{name}_dot"),
    )
    out = [f"{column} = {text} + {{{column}_bias}}" for column, text in shown if column]
    if not out:
        raise InputError("imu has no column; name that of tangential, radial or gyroscope")
    return out


def linkage(trajectories: Trajectory | Iterable[Trajectory], bodies: Iterable[tuple[str, str]]) -> Linkage:
    """Find what ties tracked points in a plane, and propose coordinates with their measurement functions.

    Tested are: points at rest, points on a straight line, constant distances from a fixed point, from another
    point, or from a place beside another point that only translates, and links that turn together. Deviations
    may be up to three times those that noise explains. Where two rods tie a point, it is placed where their
    circles meet, as in a four-bar linkage.

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
    from leastaction.data.trajectories import Trajectories
    from leastaction.estimation.linkage import assembled

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
    return assembled(data, pairs)


def __getattr__(name: str) -> type[Linkage]:
    if name == "Linkage":
        from leastaction.estimation.linkage import Linkage

        return Linkage
    raise AttributeError(f"module 'leastaction.measure' has no attribute {name!r}")
