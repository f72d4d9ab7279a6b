"""Where the object is in a picture: what differs from the empty scene, or is brighter than the dark cloth."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from sim.checks import require

_BLUR = 1.0  # [px], over which noise is averaged before the threshold
_ROUNDS = 3  # of noise and exposure from the background, background from noise
_LEVELS = 8  # classes of brightness, each with its own noise
_EVERY = (slice(None, None, 4),) * 2  # pixels that the background's statistics are taken from
_QUIET = 0.3186  # quarter quantile of |x| for a standard normal x
_MEDIAN = 0.6745  # its median
_CODED = 4.0  # grey levels by which the coding of a video may change flat parts, far apart
_FULL = 235  # grey levels from which a channel may be saturated, noise and coding allowed for
_WHITE = 0.3  # share of a part that is saturated, from which it is a lamp
_SOFT = 0.25  # of the largest part's steepness: a part with a softer outline is light on the cloth
_TRIED, _OUTLINE = 24, 30  # thresholds tried, and pixels that an outline has at least
_LEAST = 0.3  # grey levels, of rounding to whole ones


@dataclass(frozen=True, kw_only=True)
class MaskOptions:
    """sigmas: how far from the background's own noise the object begins. smallest: parts below this share of the
    largest part are specks. largest_hole: holes below this share of the object are filled (dark eyes, folds), larger
    ones stay (between an arm and the body). threshold: of 255, what is brighter, or differs by more from the empty
    scene, is the object, in place of sigmas.
    """

    sigmas: float = 6.0
    smallest: float = 0.02
    largest_hole: float = 0.02
    threshold: float | None = None

    def __post_init__(self) -> None:
        require(self.sigmas > 0, "sigmas", "be positive", self.sigmas)
        for name in ("smallest", "largest_hole"):
            value = getattr(self, name)
            require(0 <= value <= 1, name, "be a share between 0 and 1", value)
        sound = self.threshold is None or 0 < self.threshold < 255
        require(sound, "threshold", "be above 0 and below 255", self.threshold)


def plate_mask(image: np.ndarray, plate: np.ndarray, *, options: MaskOptions | None = None) -> np.ndarray:
    """The object (H, W) bool in an image (H, W[, 3]) uint8: what differs from the empty scene `plate` of its shape.

    The difference is measured in the background's own noise at that brightness, after one factor for all that the
    exposure drifted; both come from the pixels found to be background. Raises ValueError for shapes that differ.
    """
    options = options or MaskOptions()
    require(image.shape == plate.shape, "plate", f"have the picture's shape {image.shape}", plate.shape)
    seen, empty = (_channels(a) for a in (image, plate))
    full = (seen >= _FULL) & (empty >= _FULL)  # a lamp is far brighter than that: exposure does not show in it
    mask, quantile = np.zeros(image.shape[:2], bool), (0.25, _QUIET)
    for _ in range(_ROUNDS):
        free = ~_grown(mask, 3)[_EVERY]
        if free.sum() < 100:
            break
        change = np.where(full, 0, seen - _drift(seen, empty, free) * empty)
        change = cv2.GaussianBlur(change, (0, 0), _BLUR).reshape(seen.shape)
        if options.threshold is None:
            mask = np.sqrt(((change / _noise(change, empty, free, *quantile)) ** 2).sum(axis=2)) > options.sigmas
            mask &= np.abs(change).max(axis=2) > _CODED
        else:
            mask = np.abs(change).max(axis=2) > options.threshold
        quantile = (0.5, _MEDIAN)
    return cleaned(_sharpened(mask, np.abs(change).sum(axis=2)), options)


def plate_of(images: Iterable[np.ndarray]) -> np.ndarray:
    """The empty scene (H, W[, 3]) uint8: each pixel's median over pictures of it, so that who walks by leaves no trace.

    All pictures are held at once: a few dozen are plenty. Raises ValueError for none and for shapes that differ.
    """
    held = list(images)
    shapes = sorted({image.shape for image in held})
    require(len(shapes) == 1, "pictures of the empty scene", "be at least one, of one shape", shapes)
    return np.rint(np.median(held, axis=0)).astype(np.uint8)


def brightness_mask(image: np.ndarray, *, options: MaskOptions | None = None) -> np.ndarray:
    """The object (H, W) bool in an image (H, W[, 3]) uint8 before a dark cloth: what is brighter than the cloth.

    The cloth's level is the darkest peak of the brightness, its spread that of the pixels below the peak, where
    there is no object. Of the thresholds above the cloth the lowest is taken whose outline lies on edges at least
    half as steep as those of the best one: a table under the object or light on the cloth have softer ones. A part
    that is mostly saturated, and not the largest, is a lamp; one with a much softer outline than the largest, its glow.
    """
    options = options or MaskOptions()
    shown = _channels(image)
    bright = cv2.GaussianBlur(shown.max(axis=2), (0, 0), _BLUR)
    level, spread = _cloth(bright)
    full = shown.min(axis=2) >= _FULL
    least = level + options.sigmas * spread
    mask = bright > (_outlined(bright, full, level, least) if options.threshold is None else options.threshold)
    mask &= ~_lamps(mask, full)
    return cleaned(_sharpened(mask & ~_glows(mask, bright), bright - level), options)


def cleaned(mask: np.ndarray, options: MaskOptions) -> np.ndarray:
    """The mask without specks and with its small holes filled."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    if count < 2:
        return np.zeros(mask.shape, bool)
    area = stats[:, cv2.CC_STAT_AREA]
    large = area >= options.smallest * area[1:].max()
    large[0] = False
    mask = large[labels]
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    hole = stats[:, cv2.CC_STAT_AREA] <= options.largest_hole * mask.sum()
    hole[0] = False
    hole[np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))] = False
    return mask | hole[labels]


def _channels(image: np.ndarray) -> np.ndarray:
    image = image.astype(np.float32)
    return image if image.ndim == 3 else image[..., None]


def _grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    size = (2 * pixels + 1,) * 2
    return cv2.dilate(mask.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, size)) > 0


def _drift(seen: np.ndarray, empty: np.ndarray, free: np.ndarray) -> float:
    """How much brighter the picture is exposed, by the half of the background that changed least."""
    a, b = (picture[_EVERY][free].sum(axis=1) for picture in (seen, empty))
    ratio = np.median(a) / max(np.median(b), 1.0)
    away = np.abs(a - ratio * b)
    calm = away <= np.median(away)
    return float(a[calm].sum() / max(b[calm].sum(), 1.0))


def _noise(change: np.ndarray, empty: np.ndarray, free: np.ndarray, share: float, normal: float) -> np.ndarray:
    """Standard deviation (H, W, C) of the background's change, by how bright the empty scene is there."""
    level = empty.mean(axis=2)
    known, sample = level[_EVERY][free], np.abs(change[_EVERY][free])
    edges = np.quantile(known, np.linspace(0, 1, _LEVELS + 1))[1:-1]
    at = np.searchsorted(edges, known)
    spread = [np.quantile(sample[at == k], share, axis=0) / normal for k in range(_LEVELS) if (at == k).any()]
    filled = np.unique(at)
    nearest = filled[np.abs(np.arange(_LEVELS)[:, None] - filled).argmin(axis=1)]
    table = np.maximum(np.array(spread)[np.searchsorted(filled, nearest)], _LEAST)
    return table.astype(np.float32)[np.searchsorted(edges, level)]


def _cloth(bright: np.ndarray) -> tuple[float, float]:
    """Level and spread of the dark background: its peak, and the distances of the darker pixels from it."""
    counts = np.bincount(np.clip(bright, 0, 255).astype(int).ravel(), minlength=256).astype(float)
    smooth = np.convolve(counts, np.ones(5) / 5, mode="same")
    peak = float(np.flatnonzero(smooth >= 0.5 * smooth.max())[0])
    near = bright[np.abs(bright - peak) < 8]
    level = float(np.median(near))
    below = level - bright[bright < level]
    return level, max(float(np.median(below)) / _MEDIAN if len(below) else 0.0, _LEAST)


def _outlined(bright: np.ndarray, full: np.ndarray, level: float, least: float) -> float:
    """The lowest threshold from `least` on whose outline is steep, lamps' outlines left out."""
    steep = _steepness(bright)
    steep[_grown(full, 4)] = np.nan
    most = max(float(bright.max()), 2 * least - level)
    levels = level + np.geomspace(least - level, most - level, _TRIED)
    sharp = np.zeros(len(levels))
    for k, threshold in enumerate(levels):
        mask = (bright > threshold).astype(np.uint8)
        outline = steep[cv2.dilate(mask, np.ones((3, 3), np.uint8)) > mask]
        outline = outline[np.isfinite(outline)]
        sharp[k] = outline.mean() if len(outline) > _OUTLINE else 0.0
    return float(levels[np.argmax(sharp >= 0.5 * sharp.max())])


def _lamps(mask: np.ndarray, full: np.ndarray) -> np.ndarray:
    """Parts (H, W) bool of the mask, but for the largest, that are saturated in all channels over much of them."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    area, white = (np.bincount(labels.ravel(), weights.ravel(), count) for weights in (mask, full))
    lamp = white > _WHITE * np.maximum(area, 1)
    lamp[[0, int(area.argmax())]] = False
    return lamp[labels]


def _glows(mask: np.ndarray, bright: np.ndarray) -> np.ndarray:
    """Parts (H, W) bool of the mask whose outline is much softer than the largest one's: light on the cloth."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    if count < 3:
        return np.zeros(mask.shape, bool)
    around = cv2.dilate(labels.astype(np.float32), np.ones((3, 3), np.uint8)).astype(int) * (labels == 0)
    steepness = _steepness(bright)
    length, steep = (np.bincount(around.ravel(), w, count) for w in (None, steepness.ravel()))
    steep /= np.maximum(length, 1)
    largest = 1 + np.bincount(labels.ravel(), minlength=count)[1:].argmax()
    glow = steep < _SOFT * steep[largest]
    glow[0] = False
    return glow[labels]


def _steepness(bright: np.ndarray) -> np.ndarray:
    """Grey levels a pixel, (H, W)."""
    return np.hypot(*(cv2.Sobel(bright, cv2.CV_32F, *way, scale=1 / 8) for way in ((1, 0), (0, 1))))


def _sharpened(mask: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The mask cut back to where the change is half of what it is deeper inside: the blur had widened it."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.float32)
    weight = cv2.GaussianBlur(inner, (0, 0), 4.0)
    inside = cv2.GaussianBlur(inner * change.astype(np.float32), (0, 0), 4.0) / np.maximum(weight, 1e-6)
    edge = ~cv2.erode(mask.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool) & (weight > 1e-3)
    return mask & (~edge | (change > 0.5 * inside))
