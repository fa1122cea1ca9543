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


def camera(
    angles: Sequence[str],
    markers: Sequence[tuple[str, str]],
    *,
    picture: tuple[float, float] | None = None,
    perspective: bool = False,
    lens: bool = False,
) -> list[str]:
    r"""Pixels of the ends of links in a row, seen by a camera.

    With absolute angles θ_k from the vertical, a camera that faces the plane of the links sees the end of
    link n at

    .. math:: u_n = x_0 + a, \quad v_n = y_0 + b, \qquad
              a = \sum_{k \le n} l_k \sin(\theta_k + \delta), \quad
              b = \sum_{k \le n} l_k \cos(\theta_k + \delta).

    A camera that does not face the plane (``perspective``) sees it at

    .. math:: u_n = x_0 + a / w, \quad v_n = y_0 + (\sigma a + \rho b) / w, \qquad
              w = 1 + (p a + q b) / s,

    which is the general projection of a plane by a pinhole camera (Hartley and Zisserman, *Multiple View
    Geometry*, 2004, section 2.3). A lens moves each point away from the middle c of the picture, or towards
    it, by the factor :math:`1 + \kappa |(u, v) - c|^2 / s^2` (Brown, 1971, the first radial term).

    Parameters
    ----------
    angles : sequence of str
        From the pivot outwards, each measured from the vertical.
    markers : sequence of (str, str)
        Columns (right, down) of the end of each link, in pixels.
    picture : (float, float), optional
        Width and height of the picture in pixels. It is needed for ``perspective`` and ``lens``; s is half
        the width.
    perspective : bool
        Whether the plane of the camera is inclined to that of the links.
    lens : bool
        Whether straight lines appear bent, as wide-angle lenses show them.

    Returns
    -------
    list of str
        Calibration numbers: the pivot ``{x0}``, ``{y0}``, the lengths ``{l1}``, ``{l2}``, … in pixels, and
        the angle ``{tilt}`` by which the camera is rolled; with ``perspective`` also ``{shear}`` σ,
        ``{stretch}`` ρ, ``{px}`` p and ``{py}`` q; with ``lens`` also ``{bend}`` κ.

    Raises
    ------
    InputError
        If there is not one marker for each angle, a name is not allowed, or the size of the picture is
        missing or not positive.

    Notes
    -----
    Lengths are known in pixels only: no law of motion tells the size of a pixel. Offer ``perspective`` and
    ``lens`` only where they are needed: a single pendulum with small swings determines neither, which the
    finding ``calibration-open`` says.

    Examples
    --------
    >>> camera(["theta"], [("u", "v")])
    ['u = {x0} + {l1}*sin(theta + {tilt})', 'v = {y0} + {l1}*cos(theta + {tilt})']
    """
    names = check_coordinate_names(list(angles))
    if len(markers) != len(names):
        raise InputError(f"{len(markers)} markers for {len(names)} angles; give one for the end of each link")
    width, height = _size_of(picture) if perspective or lens else (0.0, 0.0)
    out: list[str] = []
    across: list[str] = []
    down: list[str] = []
    for k, (name, columns) in enumerate(zip(names, markers, strict=True), start=1):
        across.append(f"{{l{k}}}*sin({name} + {{tilt}})")
        down.append(f"{{l{k}}}*cos({name} + {{tilt}})")
        seen = " + ".join(across), " + ".join(down)
        seen = _inclined(*seen, width / 2) if perspective else seen
        seen = ("{x0} + " + seen[0], "{y0} + " + seen[1])
        seen = _bent(seen, width / 2, height / 2) if lens else seen
        out += [f"{column} = {function}" for column, function in zip(columns, seen, strict=True)]
    return out


def _size_of(picture: tuple[float, float] | None) -> tuple[float, float]:
    """Width and height of a picture; refuses what is none."""
    if picture is None:
        raise InputError(
            "perspective and lens need the size of the picture; give picture=(width, height) in pixels"
        )
    sizes = [float(size) for size in picture]
    if len(sizes) != 2 or not all(0.0 < size < float("inf") for size in sizes):
        raise InputError(f"picture is {picture!r}; expected a width and a height in pixels, both positive")
    return sizes[0], sizes[1]


def _inclined(across: str, down: str, unit: float) -> tuple[str, str]:
    """Places relative to the pivot in a picture whose plane is inclined to that of the links."""
    depth = f"(1 + ({{px=0}}*({across}) + {{py=0}}*({down}))/{unit:g})"
    return f"({across})/{depth}", f"({{shear=0}}*({across}) + {{stretch=1}}*({down}))/{depth}"


def _bent(seen: tuple[str, str], *middle: float) -> tuple[str, str]:
    """Places in a picture, moved away from its middle by a lens."""
    away = [f"({place} - {centre:g})" for place, centre in zip(seen, middle, strict=True)]
    factor = f"(1 + {{bend=0}}*({away[0]}**2 + {away[1]}**2)/{middle[0]:g}**2)"
    return f"{middle[0]:g} + {away[0]}*{factor}", f"{middle[1]:g} + {away[1]}*{factor}"


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
