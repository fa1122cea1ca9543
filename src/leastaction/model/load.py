"""Read a model from its file."""

from __future__ import annotations

import os

from leastaction.model import file as model_file
from leastaction.model.model import LagrangianModel

__all__ = ["load"]


def load(path: str | os.PathLike[str]) -> LagrangianModel:
    """Read a model that `LagrangianModel.save` has written; everything in the file is checked.

    Raises
    ------
    InputError
        If the file is not a model of this or an older version; the text names the file and the place.
    """
    return LagrangianModel.from_dict(model_file.read_document(path), os.fspath(path))
