"""Constructors of kinematic trees, for systems of known geometry.

The expanded Lagrangian of a chain of seven joints has far too many terms for a list of expressions, but only
ten parameters a link.  These constructors therefore return the tree, whose columns are computed numerically.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from leastaction.library.mjcf import read_mjcf
from leastaction.library.tree import GRAVITY, KinematicTree
from leastaction.library.urdf import read_urdf

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["FromGeometry"]


class FromGeometry:
    """Constructors of `Library` that return a `KinematicTree`, for ``leastaction.arms.identify``."""

    from_urdf: Final = staticmethod(read_urdf)
    from_mjcf: Final = staticmethod(read_mjcf)

    @staticmethod
    def from_joints(
        joints: Iterable[Mapping[str, Any]],
        *,
        modified: bool | None = None,
        gravity: ArrayLike = GRAVITY,
        base_rpy: ArrayLike = (0.0, 0.0, 0.0),
        name: str = "arm",
    ) -> KinematicTree:
        """A tree from axes and offsets, or a chain from its Denavit–Hartenberg table.

        Parameters
        ----------
        joints : iterable of mappings
            One for each joint. If `modified` is given, rows of the table (``a``, ``d``, ``alpha``,
            ``theta``), see `KinematicTree.from_dh`. Otherwise axes and offsets (``axis``, ``origin``,
            ``rpy``, ``parent``), see `KinematicTree.from_joints`. Lengths in m, angles in rad.
        modified : bool, optional
            Convention of the table: True for Craig's, False for the original one.
        gravity, base_rpy, name
            As of `KinematicTree.from_dh`.

        Raises
        ------
        InputError
            If a row is not as expected.

        Examples
        --------
        >>> from leastaction import Library
        >>> Library.from_joints([{"a": 0.3}, {"a": 0.2}], modified=False, gravity=(0.0, -9.81, 0.0))
        <KinematicTree 'arm': q1, q2>
        """
        given: dict[str, Any] = {"gravity": gravity, "base_rpy": base_rpy, "name": name}
        if modified is None:
            return KinematicTree.from_joints(joints, **given)
        return KinematicTree.from_dh(joints, modified=modified, **given)
