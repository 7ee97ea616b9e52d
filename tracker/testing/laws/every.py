"""Laws for every kind of component: be a value, be a batch, be explicit. None knows a formula."""

from __future__ import annotations

import pickle
import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import attrs
import numpy as np

from tracker.errors import DomainError
from tracker.testing.calls import Call, calls
from tracker.testing.law import KINDS, Case, agree, lanes, law
from tracker.testing.strategies import BATCHES
from tracker.types import Array


def _bits(component: Any, call: Call) -> list[bytes]:
    return [np.ascontiguousarray(answer).tobytes() for answer in call.make(component)]


def _calls(component: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    return calls(case.kind, component, case, batch)


@law(*KINDS, name="lane by lane", examples=4)
def lane_by_lane(component: Any, case: Case) -> None:
    """A batch gives what its lanes give alone, to 1e-12, for every batch shape, (2, 0) included;
    an adapter, over many steps, to 1e-10.
    """
    for batch in BATCHES:
        for call in _calls(component, case, batch):
            try:
                full = call.full(component)
            except AssertionError:
                raise
            except Exception as error:
                raise AssertionError(
                    f"{call.name} fails with a batch of shape {batch}: "
                    f"{type(error).__name__}: {error}; components come first, any batch axes last"
                ) from error
            # One run goes through LAPACK where there are matrices to factor.
            rounding = 1e-9 if case.kind in {"filter", "smoother", "adapter"} else 1e-12
            # Products of one and of many columns may differ in the last bit; steps add up.
            last = 1e-10 if case.kind == "adapter" else 1e-12
            for index in lanes(batch) if batch else []:
                _same_alone(component, call, full, index, (last, rounding))


def _same_alone(
    component: Any,
    call: Call,
    full: list[Array],
    index: tuple[int, ...],
    rounding: tuple[float, float],
) -> None:
    """Compare a lane with that lane as a batch of one, and as a single run without batch axes."""
    window = tuple(slice(i, i + 1) for i in index)
    for lane, batch, tolerance in (
        (window, (1,) * len(index), rounding[0]),
        (index, (), rounding[1]),
    ):
        given = tuple(attrs.evolve(one, value=one.lane(lane)) for one in call.given)
        alone = attrs.evolve(call, batch=batch, given=given).full(component)
        for together, single, lead in zip(full, alone, call.leads, strict=True):
            finite = np.abs(together[np.isfinite(together)])
            told = f"{call.name}: lane {index} of the batch {call.batch} differs from it "
            told += "as a batch of one" if batch else "as a single run"
            here = together[(slice(None),) * lead + lane]
            agree(here, single, tolerance, told, scale=finite.max(initial=0.0))


@law(*KINDS, name="read-only input", examples=3)
def read_only_input(component: Any, case: Case) -> None:
    """Arguments are never modified, and may be read-only."""
    for batch in ((), (3,)):
        for call in _calls(component, case, batch):
            copies = [np.array(g.value) if isinstance(g.value, np.ndarray) else g.value
                      for g in call.given]  # fmt: skip
            call.make(component, copies)
            for given, copy in zip(call.given, copies, strict=True):
                if isinstance(copy, np.ndarray):
                    assert np.array_equal(copy, given.value, equal_nan=copy.dtype != bool), (
                        f"{call.name} modifies its argument {given.name!r}: copy before you write"
                    )
                    copy.flags.writeable = False
            try:
                call.make(component, copies)
            except Exception as error:
                raise AssertionError(
                    f"{call.name} fails when its arguments are read-only "
                    f"({type(error).__name__}: {error}): copy before you write"
                ) from error


@contextmanager
def _global_state(seed: int) -> Iterator[None]:
    """The legacy global generators in a known state, and afterwards as they were."""
    before, legacy = random.getstate(), np.random.get_state()  # noqa: NPY002 - what is watched
    random.seed(seed)
    np.random.set_state(np.random.RandomState(seed).get_state())  # noqa: NPY002 - what is watched
    try:
        yield
    finally:
        random.setstate(before)
        np.random.set_state(legacy)  # noqa: NPY002 - put back as it was


def _legacy() -> tuple[Any, ...]:
    state: Any = np.random.get_state(legacy=True)  # noqa: NPY002 - what is watched
    name, keys, *rest = state
    return (random.getstate(), name, keys.tobytes(), *rest)


@law(*KINDS, name="no global random state", examples=2)
def no_global_random_state(component: Any, case: Case) -> None:
    """No call draws from, or touches, the global random state of Python or NumPy."""
    for call in _calls(component, case, (3,)):
        with _global_state(1):
            before = _legacy()
            call.make(component)
            assert _legacy() == before, (
                f"{call.name} touches the global random state: take rng as an argument"
            )


@law(*KINDS, name="same call, same answer", examples=3)
def same_call_same_answer(component: Any, case: Case) -> None:
    """A call gives the same bits whenever it is made, whatever was called before."""
    made = _calls(component, case, (3,))
    with _global_state(1):
        first = [_bits(component, call) for call in made]
    others = _calls(component, case, ())
    with _global_state(2):
        for call in others:
            call.make(component)
        for call, bits in zip(made, first, strict=True):
            assert _bits(component, call) == bits, (
                f"{call.name} answers differently the second time: a component keeps no state "
                "and draws nothing that is not in its arguments"
            )


@law(*KINDS, name="pickles", examples=2)
def pickles(component: Any, case: Case) -> None:
    """A pickled component comes back and gives the same bits, so that it can travel to a worker."""
    made = _calls(component, case, (3,))
    for call in made:  # what is computed on first use must not stand in the way
        call.make(component)
    try:
        copy = pickle.loads(pickle.dumps(component))  # noqa: S301 - our own bytes
    except Exception as error:
        raise AssertionError(
            f"it cannot be pickled ({type(error).__name__}: {error}): use functions and classes "
            "of a module, not lambdas or closures"
        ) from error
    for call in made:
        assert _bits(copy, call) == _bits(component, call), (
            f"{call.name} answers differently after pickling: something is lost on the way"
        )


def _settable(component: Any) -> list[str]:
    parameters = getattr(component, "parameters", None)
    if hasattr(component, "with_parameters") and parameters is not None:
        return [name for name, value in parameters.items() if np.ndim(value) == 0]
    if not attrs.has(type(component)):
        return []
    return [
        field.alias or field.name
        for field in attrs.fields(type(component))
        if field.init and type(getattr(component, field.name)) is float
    ]


def _no_parameters(component: Any) -> str:
    return "" if _settable(component) else "it shows no numeric parameter that could be set"


@law(*KINDS, name="refuses NaN parameters", examples=1, unless=_no_parameters)
def refuses_nan_parameters(component: Any, _case: Case) -> None:
    """A parameter that is NaN or infinite is refused with a DomainError."""
    for name in _settable(component):
        for value in (np.nan, np.inf):
            try:
                if hasattr(component, "with_parameters"):
                    component.with_parameters(**{name: value})
                else:
                    attrs.evolve(component, **{name: value})
            except DomainError:
                continue
            except Exception as error:
                raise AssertionError(
                    f"parameter {name!r} = {value} raises {type(error).__name__}, not DomainError"
                ) from error
            raise AssertionError(f"parameter {name!r} accepts {value}: raise DomainError")
