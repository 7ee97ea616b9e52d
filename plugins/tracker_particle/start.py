"""How particles begin: drawn from a Gaussian with numbers of the lane's own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tracker.errors import CapabilityError, wording
from tracker.protocols import MotionModel
from tracker.types import Gaussian
from tracker_particle import alone, draws
from tracker_particle.belief import Particles, even, spread
from tracker_particle.propagation import root


def begun(
    prior: Gaussian | Particles,
    count: int,
    rng: np.random.Generator | Sequence[np.random.Generator] | None,
    motion: MotionModel | None = None,
) -> Particles:
    """Particles of even weight from a Gaussian, singular ones too; a belief of particles is itself.

    Raises:
        CapabilityError: without a generator.
    """
    if isinstance(prior, Particles):
        return prior
    key = draws.keys(needed(rng), prior.batch)
    G = root(prior.cov)
    noise = draws.normals(key, 0, draws.START, G.shape[1], count)
    points = prior.mean[:, None] + spread(G[:, :, None], noise)
    circular = () if motion is None else tuple(motion.space.circular)
    log_weights = even(count, prior.batch)
    if count > alone.FEW:
        points, log_weights = (alone.lane_first(a, prior.batch) for a in (points, log_weights))
    return Particles(points, log_weights, key, 1, circular)


def needed(
    rng: np.random.Generator | Sequence[np.random.Generator] | None,
) -> np.random.Generator | Sequence[np.random.Generator]:
    """The generator that was given.

    Raises:
        CapabilityError: if none was.
    """
    if rng is None:
        raise CapabilityError(
            wording(
                "argument 'rng'",
                got="nothing",
                expected="a numpy.random.Generator, as particles are drawn from the prior",
                do="pass rng=np.random.default_rng(seed)",
            )
        )
    return rng
