"""Tracks against known targets: a true start, then error, consistency in words, use of scans, time.

What it means to be consistent is decided in `consistency`; how the tracks were made, elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import attrs
import numpy as np

from tracker.errors import DomainError, ShapeError, wording
from tracker.metrics.consistency import Band, chi_square_band, nees
from tracker.types import Array, Gaussian, Space, Tracks

if TYPE_CHECKING:
    from tracker.io.detections import TruthTrack
    from tracker.pipeline import PipelineHistory

_PLACE = {"overconfident": "above", "underconfident": "below", "consistent": "inside"}


def true_start(
    truth: Mapping[str, TruthTrack], space: Space, *, seconds: float, sigma: Sequence[float]
) -> Tracks:
    """Tracks that start where the targets were, and as they moved, when all paths had begun.

    Place and velocity are those of the straight line that fits the fixes of the first ``seconds``
    best; other components of the state are zero. All tracks share the covariance of ``sigma``.

    Units:
        s; sigma in those of ``space``.

    Raises:
        DomainError: if a path has less than two fixes there, or the space lacks x, y, vx or vy.
        ShapeError: if sigma is not one per component.
    """
    start = max((path.t[0] for path in truth.values()), default=0.0)
    mean = np.zeros((space.size, len(truth)))
    for i, (name, path) in enumerate(truth.items()):
        early = (path.t >= start) & (path.t <= start + seconds)
        if early.sum() < 2:
            raise DomainError(
                wording(
                    f"the truth of {name!r}",
                    got=f"{early.sum()} fixes from {start} s to {start + seconds} s",
                    expected="at least two, to tell place and velocity",
                    do="give more seconds, or drop paths that have ended by then",
                )
            )
        line = np.polynomial.polynomial.polyfit(path.t[early] - start, path.position[:, early].T, 1)
        mean[list(space.indices("x", "y", "vx", "vy")), i] = line.ravel()
    cov = np.diag(np.square(sigma))
    return Tracks(float(start), Gaussian(mean, cov), tuple(truth))


@attrs.frozen(kw_only=True)
class TrackScore:
    """How well one track followed its target.

    ``nis`` is the mean over the scans that were used, which may be of sensors of different sizes.
    An association prefers what lies near, so that NIS leans low in clutter: above its band it
    convicts a filter, inside it does not acquit. ``nees`` is that of the position, against truth.

    Units:
        rmse m; seconds s of CPU time, the median over scans, for all tracks together.
    """

    id: str
    rmse: float
    nis: float
    nis_band: Band
    nees: float
    nees_band: Band
    used: float
    seconds: float
    degrees: int = 2

    @property
    def verdict(self) -> str:
        """In one word: 'overconfident' if either statistic says so, then 'underconfident'.

        'mixed' if residuals are smaller than claimed while position errors are larger (mean NEES above
        its ``degrees``): noise was set too large, and something else is wrong.
        """
        found = {self.nees_band.verdict(self.nees), self.nis_band.verdict(self.nis)}
        word = next(
            (word for word in ("undefined", "overconfident", "underconfident") if word in found),
            "consistent",
        )
        return "mixed" if word == "underconfident" and self.nees > self.degrees else word

    @property
    def words(self) -> str:
        """The verdict with what it rests on.

        Example:
        >>> wide, narrow = chi_square_band(2), chi_square_band(400, per=200)
        >>> TrackScore(id="1", rmse=79.0, nis=2.1, nis_band=narrow, nees=9868.0, nees_band=wide,
        ...            used=0.5, seconds=2e-4).words
        'overconfident: mean position NEES 9868 above the 95 % band [0.0506, 7.38]; mean NIS 2.1 inside the 95 % band [1.73, 2.29]'
        """
        return (
            f"{self.verdict}: {_against('mean position NEES', self.nees, self.nees_band)}; "
            f"{_against('mean NIS', self.nis, self.nis_band)}"
        )


def score_tracks(
    history: PipelineHistory,
    truth: Sequence[Array],
    *,
    position: Sequence[int] = (0, 1),
    probability: float = 0.95,
) -> tuple[TrackScore, ...]:
    """One score per track, against where its target really was.

    Error and NEES are taken over all scans at whose time the truth is known. The band of mean NIS
    is for independent values, that of NEES for a single one: neighbouring errors are alike, and
    how many independent ones a run holds is not known.

    Shapes:
        truth, per track in the order of ``history.ids``: ``(d, K)`` at ``history.t``, NaN where
        unknown; position, the places of its d components in the state.

    Raises:
        ShapeError: if truth does not fit the history, or the history has batch axes.
    """
    # (K, d, tracks)
    known = np.moveaxis(np.stack([np.asarray(path) for path in truth]), (0, 1, 2), (2, 1, 0))
    expected = (len(history), len(position), len(history.ids))
    if known.shape != expected or history.mean.ndim != len(expected):
        raise ShapeError(
            wording(
                "argument 'truth'",
                got=f"{len(truth)} paths of shape {np.shape(truth[0])} for means {history.mean.shape}",
                expected=f"{expected[2]} paths of shape {expected[1::-1]}, and no batch axes",
                do="pass [path.at(history.t) for each track]",
            )
        )
    places = list(position)
    errors = history.mean[:, places] - known
    surprise = nees(errors, history.cov[:, places][:, :, places])
    seconds = float(np.median(history.seconds)) if len(history) else np.nan
    scores = []
    for i, name in enumerate(history.ids):
        judged = ~np.isnan(known[:, :, i]).any(axis=1)
        used = history.detection[:, i] >= 0
        count = int(used.sum())
        scores.append(
            TrackScore(
                id=name,
                rmse=float(np.sqrt(_mean((errors[judged, :, i] ** 2).sum(axis=1)))),
                nis=_mean(history.nis[used, i]),
                nis_band=chi_square_band(
                    float(history.count[used, i].sum()), probability, per=max(count, 1)
                ),
                nees=_mean(surprise[judged, i]),
                nees_band=chi_square_band(len(places), probability),
                used=_mean(used.astype(np.float64)),
                seconds=seconds,
                degrees=len(places),
            )
        )
    return tuple(scores)


def _mean(values: Array) -> float:
    return float(values.mean()) if values.size else np.nan


def _against(name: str, mean: float, band: Band) -> str:
    place = _PLACE.get(band.verdict(mean))
    if place is None:
        return f"{name} undefined"
    size = f"{mean:.0f}" if mean >= 100 else f"{mean:.3g}"
    return (
        f"{name} {size} {place} the {100 * band.probability:g} % band "
        f"[{band.low:.3g}, {band.high:.3g}]"
    )
