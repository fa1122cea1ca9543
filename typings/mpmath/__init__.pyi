from typing import Any

class mpf:
    def __init__(self, value: object) -> None: ...
    def __mul__(self, other: Any) -> mpf: ...

# A context, whose functions take its own numbers only: they are objects in NumPy's arrays anyway.
mp: Any
