"""What leastaction uses of loky."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor

class ProcessPoolExecutor(Executor):
    def __init__(
        self,
        max_workers: int | None = None,
        *,
        timeout: float | None = None,
        initializer: Callable[..., None] | None = None,
        initargs: tuple[object, ...] = (),
        env: Mapping[str, str] | None = None,
    ) -> None: ...
    def shutdown(self, wait: bool = True, kill_workers: bool = False) -> None: ...  # type: ignore[override]
