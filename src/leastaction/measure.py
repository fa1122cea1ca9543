"""Measurement functions that are often needed, as texts for ``discover(measure=...)``.

They are expressions like any other: print them, change them, or write your own.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from leastaction.errors import InputError
from leastaction.identifiers import check_coordinate_names

if TYPE_CHECKING:
    from leastaction.estimation.linkage import Linkage, linkage

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


if not TYPE_CHECKING:

    def __getattr__(name: str):
        """Linkages need NumPy and SciPy, which are imported when they are first used."""
        if name in ("Linkage", "linkage"):
            return getattr(import_module("leastaction.estimation.linkage"), name)
        raise AttributeError(f"module 'leastaction.measure' has no attribute {name!r}")
