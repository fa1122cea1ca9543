"""How objects show themselves: a card in a notebook or a terminal, a plot, a data frame."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup, escape

from leastaction.errors import InputError, MissingPackageError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Card", "Display", "Panel", "Series", "Shown", "Typeset", "data_frame", "show"]

_MOST_ROWS = 20  # of a table; a card is a summary
_MOST_LABELS = 10  # of a legend
_PANEL = (7.0, 2.4)  # inches; an empty strip for the title and the axis of time comes on top
# Colours are those of the notebook: what is quiet is translucent, so that it is quiet in the dark, too.
# JupyterLab sets tables right and stripes them; a term is read from the left.
_STYLE = """.leastaction{max-width:60em;overflow-x:auto;line-height:1.5}
.leastaction .title{font-weight:600}
.leastaction p{margin:.2em 0}
.leastaction ul{margin:.3em 0;padding-left:1.3em}
.leastaction .formula{display:flex;flex-wrap:wrap;align-items:baseline;gap:.15em .45em}
.leastaction .formula{margin:.5em 0;font-size:1.1em}
.leastaction table{border-collapse:collapse;margin:.5em 0;border:none;color:inherit;background:none}
.leastaction th,.leastaction td{text-align:left;padding:.15em 1.2em .15em 0}
.leastaction th,.leastaction td{border:none;vertical-align:baseline}
.leastaction th{font-weight:600;border-bottom:1px solid rgba(128,128,128,.5)}
.leastaction tbody tr{background:none}
.leastaction .quiet{opacity:.7}
.leastaction mi.q{font-style:italic}
.leastaction math .error{font-size:.7em;opacity:.7}
.leastaction .dot{font-weight:700}
""".replace("\n", "")


class Typeset(NamedTuple):
    """What reads one way as text and another as HTML, such as a formula."""

    text: str
    html: Markup


Piece = str | Typeset


class Card(NamedTuple):
    """What an object says of itself.

    Parameters
    ----------
    title : str
    lines : sequence of str or Typeset
        Sentences and formulas below the title.
    rows : sequence of rows of str or Typeset
        A table, the header first; of a long one the first rows are shown.
    notes : sequence of str or Typeset
        A list below the table.
    """

    title: str
    lines: Sequence[Piece] = ()
    rows: Sequence[Sequence[Piece]] = ()
    notes: Sequence[Piece] = ()

    def html(self) -> str:
        """Return an element for notebooks, dark ones too; all that is not typeset is escaped.

        Examples
        --------
        >>> "&lt;b&gt;" in Card("run <b>").html()
        True
        """
        parts = [Markup('<p class="title">{}</p>').format(self.title)]
        parts += [_paragraph(line) for line in self.lines]
        if self.rows:
            head, *body = self.rows
            table = Markup("").join(_row(row, "td") for row in body[:_MOST_ROWS])
            parts.append(
                Markup("<table><thead>{}</thead><tbody>{}</tbody></table>").format(_row(head, "th"), table)
            )
            parts += [Markup('<p class="quiet">{}</p>').format(line) for line in self._more()]
        if self.notes:
            items = Markup("").join(Markup("<li>{}</li>").format(_html(note)) for note in self.notes)
            parts.append(Markup("<ul>{}</ul>").format(items))
        body = Markup("").join(parts)
        return f'<div class="leastaction"><style>{_STYLE}</style>{body}</div>'

    def text(self) -> str:
        """Return lines of text, columns one below the other.

        Examples
        --------
        >>> print(Card("two runs", rows=[("trial", "samples"), ("a", "201"), ("long name", "9")]).text())
        two runs
        trial      samples
        a          201
        long name  9
        """
        rows = [[_text(cell) for cell in row] for row in self.rows[: _MOST_ROWS + 1]]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        table = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        return "\n".join(
            [self.title, *map(_text, self.lines), *table, *self._more(), *map(_text, self.notes)]
        )

    def _more(self) -> list[str]:
        more = len(self.rows) - 1 - _MOST_ROWS
        return [f"and {more} more"] if more > 0 else []


class Shown:
    """An object with a card; `show` and notebooks ask for it."""

    def _card(self) -> Card:
        """What the object says of itself, for `show` and notebooks."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return self._card().html()

    def __repr__(self) -> str:
        return f"<{self._card().title}>"


def _text(piece: Piece) -> str:
    return piece.text if isinstance(piece, Typeset) else piece


def _html(piece: Piece) -> Markup:
    return piece.html if isinstance(piece, Typeset) else escape(piece)


def _paragraph(line: Piece) -> Markup:
    kind = Markup(' class="formula"') if isinstance(line, Typeset) else ""
    return Markup("<p{}>{}</p>").format(kind, _html(line))


def _row(row: Sequence[Piece], tag: str) -> Markup:
    cells = [
        Markup('<{0} title="{1}">{2}</{0}>').format(Markup(tag), cell.text, cell.html)
        if isinstance(cell, Typeset)
        else Markup("<{0}>{1}</{0}>").format(Markup(tag), cell)
        for cell in row
    ]
    return Markup("<tr>{}</tr>").format(Markup("").join(cells))


def show(*things: Any) -> None:
    """Display models, trajectories, libraries, forecasts and other objects: rich in a notebook, text
    elsewhere.

    In a notebook, each object is displayed as if it were the last line of a cell, so that a cell or a loop
    can show several. In a terminal or a script, the same content is printed as text. For a model this is the
    formula, the table of terms with errors, the verdict and the findings. Other objects are displayed by the
    notebook or printed.

    Parameters
    ----------
    *things
        Objects of leastaction, or any others.

    Examples
    --------
    >>> import leastaction as la
    >>> la.show(la.Library(["x_dot**2", "x**2"], ["x"], dissipation=["x_dot**2/2"]))
    Library of x: 2 terms, 1 of dissipation
    term        kind
    x_dot**2    lagrangian
    x**2        lagrangian
    x_dot**2/2  dissipation
    """
    display = _display()
    for thing in things:
        if display is not None:
            display(thing)
        else:
            print(thing._card().text() if isinstance(thing, Shown) else thing)


def _display() -> Callable[[Any], object] | None:
    """How the notebook displays objects; None in a terminal, that of IPython included."""
    ipython = sys.modules.get("IPython")  # who did not import it is not in a notebook
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from IPython.display import display  # type: ignore[import-not-found]

    return display


def data_frame(columns: Mapping[str, Iterable[Any]], use: str = "to_frame()") -> pd.DataFrame:
    """Columns as a data frame of pandas.

    Raises
    ------
    MissingPackageError
        If pandas is not installed: an `InputError` and an ImportError.

    Examples
    --------
    >>> data_frame({"t": [0.0, 0.1], "x": [1.0, 2.0]}).shape
    (2, 2)
    """
    try:
        import pandas as pd
    except ImportError:
        raise MissingPackageError(use, "pandas", "pandas") from None
    return pd.DataFrame(dict(columns))


class Series(NamedTuple):
    """One line of a plot, or one set of points; ``errors`` are half lengths of bars along x.

    Parameters
    ----------
    x, y : array_like, shape (n,)
    label : str
        For the legend.
    errors : array_like, shape (n,), optional
    style : mapping
        Properties of Matplotlib's lines.
    """

    x: Any
    y: Any
    label: str = ""
    errors: Any = None
    style: Mapping[str, Any] = {}


class Panel(NamedTuple):
    """What stands on one pair of axes.

    Parameters
    ----------
    name, unit : str
        What is along y; the unit is empty where it is not known.
    series : sequence of Series
    x_label : str
    y_scale : str
        As Matplotlib names scales.
    rows : sequence of str
        Names for y = 0, 1, ..., from top to bottom, in place of numbers.
    """

    name: str
    unit: str
    series: Sequence[Series]
    x_label: str = "time (s)"
    y_scale: str = "linear"
    rows: Sequence[str] = ()

    @property
    def y_label(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


class Display:
    """A Matplotlib plot, returned by the ``plot`` methods.

    Attributes
    ----------
    figure_ : matplotlib.figure.Figure
    ax_ : matplotlib.axes.Axes
        The first, or only, axes.
    axes_ : ndarray of matplotlib.axes.Axes, shape (n_panels,)
    lines_ : list of list of matplotlib.artist.Artist
        The lines, or containers of error bars, of each panel in the order of the legend.

    Examples
    --------
    >>> import leastaction as la
    >>> display = la.Trajectory([0.0, 0.1], [1.0, 0.9], coordinates=["theta"]).plot(color="black")
    >>> display.ax_.get_xlabel(), display.ax_.get_ylabel(), len(display.lines_[0])
    ('time (s)', 'θ', 1)
    >>> display.figure_.savefig("theta.png")  # doctest: +SKIP
    """

    figure_: Figure
    ax_: Axes
    axes_: np.ndarray
    lines_: list[list[Artist]]

    def __init__(self, panels: Sequence[Panel], title: str = "") -> None:
        self.panels: tuple[Panel, ...] = tuple(panels)
        self.title: str = title

    def plot(self, ax: Axes | Sequence[Axes] | None = None, **kwargs: Any) -> Display:
        """Draw the plot, possibly again in other axes.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, or sequence of them, optional
            One axes for everything, or one for each panel. By default, a new figure with panels one below the
            other.
        **kwargs
            Properties of Matplotlib's lines, such as ``color`` and ``linewidth``, for all that is drawn.

        Returns
        -------
        Display
            Itself.

        Raises
        ------
        InputError
            If there are several axes, but not one for each panel; also, and an ImportError then, if
            Matplotlib is not installed (extra ``plot``).
        """
        self.axes_ = _axes_for(ax, self.panels)
        self.ax_ = self.axes_[0]
        self.figure_ = self.ax_.get_figure()  # type: ignore[assignment]
        shared = len(set(map(id, self.axes_))) < len(self.panels)
        pairs = list(zip(self.panels, self.axes_, strict=True))
        self.lines_ = [_draw(panel, axes, panel.name if shared else "", kwargs) for panel, axes in pairs]
        if shared:
            units = {panel.unit for panel in self.panels}
            self.ax_.set_ylabel(units.pop() if len(units) == 1 else "")
        if ax is None:
            self.ax_.set_title(self.title)
        if 1 < len(self.ax_.get_legend_handles_labels()[1]) <= _MOST_LABELS:
            self.ax_.legend()  # panels hold the same lines: one legend is enough
        return self


def _axes_for(ax: Any, panels: Sequence[Panel]) -> np.ndarray:
    """Axes for each panel; new ones share their axis of time."""
    try:
        import matplotlib.pyplot as plt
        from matplotlib.axes import Axes
    except ImportError:
        raise MissingPackageError("plot()", "Matplotlib", "plot") from None
    n = len(panels)
    out = np.empty(n, dtype=object)
    if ax is None:
        size = (_PANEL[0], max(_PANEL[1] * n, 0.5 * max(len(p.rows) for p in panels)) + 1.2)
        _, new = plt.subplots(n, 1, sharex=True, squeeze=False, figsize=size, layout="constrained")
        out[:] = new[:, 0]
        for axes in out[:-1]:
            axes.tick_params(labelbottom=False)
    elif isinstance(ax, Axes):
        out[:] = [ax] * n
    else:
        given = np.ravel(np.asarray(ax, dtype=object))
        if len(given) != n or not all(isinstance(axes, Axes) for axes in given):
            raise InputError(
                f"ax holds {len(given)} object(s); expected one Axes for all, or one for each of {n}"
            )
        out[:] = given
    last = {id(axes): axes for axes in ([out[-1]] if ax is None else out)}
    for axes in last.values():
        axes.set_xlabel(panels[0].x_label)
    return out


def _draw(panel: Panel, axes: Any, name: str, options: Mapping[str, Any]) -> list[Artist]:
    """Draw a panel; `name` stands before the labels where panels share their axes."""
    drawn: list[Artist] = []
    for series in panel.series:
        style = {**series.style, **options, "label": ", ".join(filter(None, (name, series.label))) or None}
        if series.errors is None:
            drawn += axes.plot(series.x, series.y, **style)
        else:
            drawn.append(axes.errorbar(series.x, series.y, xerr=series.errors, **style))
    axes.set_ylabel(panel.y_label)
    axes.set_yscale(panel.y_scale)
    if panel.rows:
        axes.set_yticks(range(len(panel.rows)), panel.rows)
        axes.set_ylim(len(panel.rows) - 0.5, -0.5)
    return drawn
