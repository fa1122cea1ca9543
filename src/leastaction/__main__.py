"""``python -m leastaction`` is the command line program."""

from __future__ import annotations

from leastaction.cli import main

if __name__ == "__main__":
    main()
