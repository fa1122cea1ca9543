"""Draw the figures: ``python -m reproduction.figures [--only NAME] [--output FOLDER] [--pixels N]``.

Writes one file per figure, and ``figures.json`` with titles, captions and the numbers in them.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from reproduction import _figure_ablation, _figure_basins, _figure_magnetic
from reproduction._plots import write_png, write_svg

__all__ = ["NAMES", "main", "make"]

NAMES = ("ablation", "magnetic", "basins")
_TITLES = {
    "ablation": "The penalty on accelerations",
    "magnetic": "Forecasts of the magnetic pendulum",
    "basins": "Basins of attraction",
}


def make(name: str, output: Path, pixels: int) -> dict:
    """Compute and draw one figure; return its record."""
    if name == "ablation":
        ablations = _figure_ablation.compute(_figure_ablation.STARTS)
        write_svg(_figure_ablation.draw(ablations), output / "ablation.svg")
        return _record(
            "ablation.svg", _figure_ablation.caption(ablations), _figure_ablation.numbers(ablations)
        )
    if name == "magnetic":
        forecast = _figure_magnetic.compute(_figure_magnetic.LONG)
        write_svg(_figure_magnetic.draw(forecast), output / "magnetic.svg")
        return _record("magnetic.svg", _figure_magnetic.caption(forecast), _figure_magnetic.numbers(forecast))
    study = _figure_basins.compute(pixels, others=_figure_basins.OTHER_DAMPINGS, progress=_say)
    write_png(_figure_basins.draw(study), output / "basins.png", _figure_basins.dpi(pixels))
    return _record("basins.png", _figure_basins.caption(study), _figure_basins.numbers(study))


def _record(file: str, caption: str, numbers: dict) -> dict:
    return {"file": file, "caption": caption, "numbers": _finite(numbers)}


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _finite(value):
    """Return the same numbers with None for what JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _write(records: dict, output: Path) -> None:
    """Write the record of all figures."""
    present = {name: {"title": _TITLES[name], **records[name]} for name in NAMES if name in records}
    text = json.dumps(present, indent=2, ensure_ascii=False, allow_nan=False)
    (output / "figures.json").write_text(text + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m reproduction.figures", description="Draw the figures.")
    parser.add_argument("--only", choices=NAMES, help="draw this figure only")
    parser.add_argument("--output", type=Path, default=Path("reproduction/figures"))
    parser.add_argument("--pixels", type=int, default=400, help="starts along a side of the basins' square")
    options = parser.parse_args(arguments)
    if options.pixels < 2:
        parser.error("--pixels must be at least 2")
    options.output.mkdir(parents=True, exist_ok=True)
    file = options.output / "figures.json"
    records = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for name in NAMES if options.only is None else (options.only,):
        begin = time.perf_counter()
        records[name] = make(name, options.output, options.pixels)
        _write(records, options.output)
        _say(f"{name}: {options.output / records[name]['file']} after {time.perf_counter() - begin:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
