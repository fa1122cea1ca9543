"""Which names a coordinate may have, and how names, values and numbers of things are written in messages."""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Collection, Iterable
from itertools import count

from leastaction.errors import InputError

__all__ = [
    "ANGLE_NAMES",
    "FUNCTION_NAMES",
    "RESERVED_NAMES",
    "TIME",
    "check_coordinate_names",
    "counted",
    "free_name",
    "measured_columns",
    "names_in_terms",
    "quoted",
    "split_name",
    "split_names",
    "written_name",
]

ANGLE_NAMES = ("theta", "phi", "psi", "alpha", "beta", "gamma", "angle", "winkel", *"θφψαβϕ")
"""How the names of angles usually begin, in lower case."""

FUNCTION_NAMES = frozenset({"sin", "cos", "tan", "exp", "log", "sqrt", "abs"})
"""Functions that an expression may call."""

TIME = "t"
"""Name of the time in expressions."""

RESERVED_NAMES = frozenset({"pi", TIME, "E", "I"})
"""Names with a fixed meaning: the constants, and the time."""

_ASCII_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_MAX_LENGTH = 64
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def measured_columns(functions: Iterable[str]) -> tuple[str, ...]:
    """Columns on the left of measurement functions, such as u of ``"u = {s}*x"``."""
    return tuple(text.partition("=")[0].strip() for text in functions)


def quoted(value: object, limit: int = 40) -> str:
    """Return ``repr(value)`` cut to `limit` characters: safe to put into a message.

    Parameters
    ----------
    value : object
        Anything, also text that somebody hostile has written.
    limit : int
        Greatest length of the result.

    Returns
    -------
    str

    Examples
    --------
    >>> quoted("theta")
    "'theta'"
    >>> quoted("a" * 100, limit=12)
    "'aaaaaaaa..."
    """
    try:
        # Cut long text before repr: repr of a very long name would cost time and memory for nothing.
        text = repr(value[: limit + 1] if isinstance(value, str) else value)
    except Exception:  # Python refuses to print very long integers; and any class may be broken
        text = f"<{type(value).__name__}>"
    text = "".join(c if c.isprintable() else " " for c in text[: limit + 1])
    return text if len(text) <= limit else text[: limit - 3] + "..."


def counted(n: int, noun: str, plural: str = "") -> str:
    """A number with its noun.

    Examples
    --------
    >>> counted(1, "term"), counted(2, "trajectory", "trajectories")
    ('1 term', '2 trajectories')
    """
    return f"{n} {noun if n == 1 else plural or noun + 's'}"


def check_coordinate_names(names: Iterable[str] | str) -> tuple[str, ...]:
    """Check the names of coordinates and return them NFKC-normalised.

    A name is a letter followed by up to 63 letters, digits and underscores; Greek and other Unicode
    letters are letters. It is no Python keyword, no function of the expression grammar (``sin`` ...),
    none of ``pi``, ``t``, ``E``, ``I``, and does not end in ``_dot``, which marks a velocity.

    Parameters
    ----------
    names : iterable of str, or str
        One name per coordinate; a single string is one name.

    Returns
    -------
    tuple of str
        The names in the same order, normalised as Python normalises identifiers (``"ϑ"`` becomes
        ``"θ"``), so that equal-looking names are equal.

    Raises
    ------
    InputError
        If there is no name, a name breaks a rule, or two names are the same.

    Examples
    --------
    >>> check_coordinate_names(["theta1", "φ"])
    ('theta1', 'φ')
    >>> check_coordinate_names(["theta_dot"])
    Traceback (most recent call last):
        ...
    leastaction.errors.InputError: coordinate name 'theta_dot' ends in '_dot', which marks a velocity; ...
    """
    if isinstance(names, str):
        names = (names,)
    try:
        given = tuple(names)
    except TypeError:
        raise InputError(f"coordinates must be a sequence of names, not {quoted(names)}") from None
    if not given:
        raise InputError("coordinates is empty; name at least one coordinate, e.g. ['theta']")
    checked: list[str] = []
    for name in given:
        normal = _check_one(name)
        if normal in checked:
            raise InputError(
                f"coordinate name {quoted(name)} occurs twice; each coordinate needs its own name"
            )
        checked.append(normal)
    return tuple(checked)


def free_name(letter: str, taken: Collection[str]) -> str:
    """The letter, or the letter with the first number, that is not taken.

    Examples
    --------
    >>> free_name("h", ["x"]), free_name("h", ["h", "h1"])
    ('h', 'h2')
    """
    return next(name for k in count() if (name := f"{letter}{k or ''}") not in taken)


def names_in_terms(coordinates: Iterable[str]) -> list[str]:
    """Names that a term may hold: the coordinates, their velocities, and the time.

    Examples
    --------
    >>> names_in_terms(["theta"])
    ['theta', 'theta_dot', 't']
    """
    names = list(coordinates)
    return [*names, *(f"{name}_dot" for name in names), TIME]


def split_name(name: str) -> tuple[str, str]:
    """Head and subscript of a name, Greek letters as such.

    Examples
    --------
    >>> split_name("theta_arm2"), split_name("x")
    (('θ', 'arm,2'), ('x', ''))
    """
    head, *rest = re.findall(r"\d+|[^\W\d_]+", name) or [name]
    return _letter(head), ",".join(_letter(part) for part in rest)


def split_names(names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Head and subscript of each name; names that would look alike are left as they are.

    Examples
    --------
    >>> split_names(["theta1", "q1", "q_1"])
    {'theta1': ('θ', '1'), 'q1': ('q1', ''), 'q_1': ('q_1', '')}
    """
    parts = {name: split_name(name) for name in names}
    all_parts = list(parts.values())
    return {name: part if all_parts.count(part) == 1 else (name, "") for name, part in parts.items()}


def written_name(head: str, subscript: str) -> str:
    """A name as plain text for figures.

    Examples
    --------
    >>> written_name("θ", "1"), written_name("x", "cart")
    ('θ₁', 'x_cart')
    """
    if subscript.isdecimal():
        return f"{head}{subscript.translate(_SUBSCRIPTS)}"
    return f"{head}_{subscript.replace(',', '_')}" if subscript else head


def _letter(word: str) -> str:
    """The Greek letter of this name, or the word itself."""
    size = {word.lower(): "SMALL", word.capitalize(): "CAPITAL"}.get(word)
    if size is None or len(word) == 1:
        return word
    try:
        return unicodedata.lookup(
            f"GREEK {size} LETTER {'LAMDA' if word.lower() == 'lambda' else word.upper()}"
        )
    except KeyError:
        return word


def _check_one(name: object) -> str:
    if not isinstance(name, str):
        raise InputError(f"coordinate name {quoted(name)} is not text; use names such as 'theta1'")
    normal = unicodedata.normalize("NFKC", name) if len(name) <= 4 * _MAX_LENGTH else name
    problem = _problem(normal)
    if problem:
        raise InputError(f"coordinate name {quoted(name)} {problem}")
    # The plain str, so that subclasses (numpy.str_) do not travel on.
    return str(normal)


def _problem(name: str) -> str | None:
    if len(name) > _MAX_LENGTH:
        return f"is too long; use at most {_MAX_LENGTH} characters"
    if not _is_identifier(name):
        return "is not a name; use a letter followed by letters, digits and underscores, e.g. 'theta1'"
    if keyword.iskeyword(name):
        return "is a Python keyword; choose another name"
    if name in FUNCTION_NAMES:
        return "is the name of a function; choose another name"
    if name in RESERVED_NAMES:
        return "is reserved (pi, E and I are constants, t is the time); choose another name"
    if name.endswith("_dot"):
        return "ends in '_dot', which marks a velocity; name the coordinate alone, without '_dot'"
    return None


def _is_identifier(name: str) -> bool:
    if name.isascii():
        return _ASCII_NAME.fullmatch(name) is not None
    # Letters only beyond ASCII: combining marks would let two different names look alike.
    plain = all(c.isalpha() or c == "_" or c in "0123456789" for c in name)
    return plain and name[0].isalpha() and name.isidentifier()
