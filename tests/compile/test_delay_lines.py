"""Delay lines: a window over the past at the price of one load and one store a step."""

import numpy as np
import pytest

from tracker.compile import objects
from tracker.compile.llvm import Kernel
from tracker.compile.program import Program, Rate, allocate, interpret, tile, untile
from tracker.errors import ShapeError
from tracker.models import sin

STEPS, LANES = 40, 11


def window_sum(length, variants=1):
    """Sum of the last ``length`` values of sin z; with variants, of z or of -2 z."""
    program = Program(variants=variants)
    if variants > 1:
        program.input("variant", 1, Rate.STEP)
    (z,) = program.input("z", 1, Rate.BOTH)
    (total,) = program.state("total", 1)
    (old,) = program.delay("window", 1, length)
    for variant in range(variants):
        new = sin(z) if variants == 1 else (z, -2.0 * z)[variant]
        program.feed("window", [new], variant)
        program.set("total", [total + new - old], variant)
        program.history("out", [total + new - old], variant)
    return program


def ran(program, z, variant=None, how="kernel"):
    groups = -(-LANES // 8)
    arrays = {k: allocate(s) for k, s in program.shapes(groups, STEPS).items()}
    arrays["z"][:] = tile(z[:, None])
    if variant is not None:
        arrays["variant"][:, 0] = variant
    if how == "kernel":
        Kernel(program).bind(arrays, groups, STEPS)(0, groups)
    else:
        interpret(program, arrays, STEPS)
    return untile(arrays["out"], LANES)[:, 0]


def expected(values, length):
    total = np.cumsum(values, axis=0)
    total[length:] -= np.cumsum(values, axis=0)[:-length].copy()
    return total


@pytest.mark.parametrize("how", ["interpreter", "kernel"])
@pytest.mark.parametrize("length", [1, 2, 25, 39, 40])
def test_a_window_holds_the_last_values_and_no_others(length, how):
    if how == "kernel" and not objects.available():
        pytest.skip("llvmlite is not installed")
    z = np.random.default_rng(1).standard_normal((STEPS, LANES))
    np.testing.assert_allclose(
        ran(window_sum(length), z, how=how), expected(np.sin(z), length), atol=1e-13
    )


@pytest.mark.parametrize("how", ["interpreter", "kernel"])
def test_variants_feed_one_line(how):
    if how == "kernel" and not objects.available():
        pytest.skip("llvmlite is not installed")
    rng = np.random.default_rng(2)
    z, which = rng.standard_normal((STEPS, LANES)), rng.integers(0, 2, STEPS)
    values = np.where(which[:, None] == 0, z, -2.0 * z)
    got = ran(window_sum(7, variants=2), z, which, how)
    np.testing.assert_allclose(got, expected(values, 7), atol=1e-13)


def test_a_line_that_nothing_feeds_is_refused():
    program = Program()
    (old,) = program.delay("window", 1, 3)
    program.state("x", 1)
    program.set("x", [old])
    with pytest.raises(ShapeError, match="delay lines"):
        program.finished()


def test_a_line_is_described():
    assert "delay   window   1 by 25 steps" in window_sum(25).describe()
