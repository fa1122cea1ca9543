"""One BLAS thread inside, the user's number again afterwards."""

from __future__ import annotations

import signal
import threading

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import leastaction as la
from leastaction import systems
from leastaction.threads import _interrupts_later, single_threaded


def blas_threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


@pytest.fixture
def two():
    """BLAS with two threads, which the tests must find again."""
    if not blas_threads():
        pytest.skip("no BLAS that threadpoolctl knows")
    with threadpool_limits(2, user_api="blas"):
        if set(blas_threads()) != {2}:
            pytest.skip("this BLAS has one thread only")
        yield
        assert set(blas_threads()) == {2}


@pytest.mark.usefixtures("two")
def test_nested():
    with single_threaded():
        with single_threaded():
            assert set(blas_threads()) == {1}
        assert set(blas_threads()) == {1}
    assert set(blas_threads()) == {2}


@pytest.mark.usefixtures("two")
def test_left_by_an_error():
    @single_threaded()
    def fails():
        raise ZeroDivisionError(blas_threads())

    with pytest.raises(ZeroDivisionError) as raised:
        fails()
    assert set(raised.value.args[0]) == {1}
    assert set(blas_threads()) == {2}


@pytest.mark.usefixtures("two")
@pytest.mark.parametrize("outlives", [False, True])
def test_calls_that_overlap_leave_the_number_of_the_user(outlives):
    entered, leave = threading.Event(), threading.Event()

    @single_threaded()
    def other():
        entered.set()
        leave.wait(10)

    thread = threading.Thread(target=other)
    with single_threaded():
        thread.start()
        assert entered.wait(10)
        if not outlives:
            leave.set()
            thread.join()
        assert set(blas_threads()) == {1}
    assert set(blas_threads()) == {2}
    leave.set()
    thread.join()


@pytest.mark.usefixtures("two")
def test_discover_and_simulate_compute_with_one_thread():
    data = systems.generate("single_pendulum", noise=0.01, trials=1, duration=3.0, rate=50.0)
    seen = {}
    model = la.discover(
        data,
        ["theta_dot**2", "cos(theta)"],
        progress=lambda stage, details: seen.setdefault(stage, blas_threads()),
    )
    assert {"prepare", "search", "verify"} <= seen.keys()
    assert all(set(threads) == {1} for threads in seen.values())
    inside: list[int] = []

    def forces(t):
        inside.extend(blas_threads())
        return np.zeros(1)

    model.simulate([0.3], [0.0], np.linspace(0.0, 0.1, 3), forces)
    assert set(inside) == {1}


def test_the_decorated_function_keeps_its_name_and_signature():
    assert la.discover.__name__ == "discover"
    assert "trajectories" in la.discover.__wrapped__.__code__.co_varnames


@pytest.fixture
def interruptible():
    """Ctrl-C raises KeyboardInterrupt, even where whoever started the tests ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_is_held_back_and_not_lost():
    """The search for BLAS libraries calls back from C: an exception raised there would be ignored."""
    before, steps = signal.getsignal(signal.SIGINT), []

    def interrupted() -> None:
        with _interrupts_later():
            signal.raise_signal(signal.SIGINT)
            steps.append("inside")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert steps == ["inside"]
    assert signal.getsignal(signal.SIGINT) is before
