from typing import Any, Self

class mpf:
    def __init__(self, value: object) -> None: ...
    def __mul__(self, other: Any) -> mpf: ...

# A context takes its own numbers only; in NumPy's arrays they are objects.
class MPContext:
    dps: int
    pi: Any
    e: Any
    def mpf(self, value: Any) -> Any: ...
    sin: Any
    cos: Any
    tan: Any
    exp: Any
    log: Any
    sign: Any
    def clone(self) -> Self: ...

mp: MPContext
