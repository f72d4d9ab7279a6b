"""From light to the numbers of a video: exposure that drifts, the display's curve, grain."""

from dataclasses import dataclass

import numpy as np

from recon.cameras import Camera

GAMMA = 1 / 2.2
GREY = np.array([0.30, 0.56, 0.14], np.float32)  # what a grey sensor makes of linear RGB
GRAINIER = {"colour": 1.0, "left": 1.3, "right": 1.3}
SLACK = 64  # pixels by which the pattern of grain is larger than the picture
CYCLES = (0.6, 1.7)  # of the exposure's drift in a recording


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensor:
    """One stream's. Its grain is one large pattern, shifted at random in every frame."""

    grey: bool
    seed: tuple[int, int, int]
    grain: np.ndarray  # (H + SLACK, W + SLACK[, 3]) float32, grey levels
    drift: np.ndarray  # (F,) relative exposure

    @classmethod
    def of(cls, camera: Camera, frames: int, noise: float, drift: float, seed: int) -> "Sensor":
        """noise: standard deviation in grey levels; drift: largest change of exposure, the same in all of a device."""
        width, height = camera.size
        number, stream = int(camera.device[3:]), list(GRAINIER).index(camera.stream)
        grey = camera.stream != "colour"
        shape = (height + SLACK, width + SLACK, *(() if grey else (3,)))
        grain = np.random.default_rng([2, seed, number, stream]).standard_normal(shape, np.float32)
        rng = np.random.default_rng([3, seed, number])
        phase, cycles = rng.uniform(0, 2 * np.pi), rng.uniform(*CYCLES)
        wave = np.sin(phase + 2 * np.pi * cycles * np.arange(frames) / max(frames, 2))
        return cls(grey=grey, seed=(seed, number, stream), grain=grain * np.float32(noise * GRAINIER[camera.stream]),
                   drift=1 + drift * wave)  # fmt: skip

    def shown(self, light: np.ndarray) -> np.ndarray:
        """Linear RGB (H, W, 3) as grey levels 0..255, float32, of the sensor's own kind."""
        light = light @ GREY if self.grey else light
        return np.float32(255) * np.clip(light, 0, 1).astype(np.float32) ** np.float32(GAMMA)

    def exposed(self, levels: np.ndarray, frame: int) -> np.ndarray:
        """Levels (H, W[, 3]) of a frame with its exposure and grain, uint8."""
        height, width = levels.shape[:2]
        row, column = np.random.default_rng([4, *self.seed, frame]).integers(0, SLACK, 2)
        out = levels * np.float32(self.drift[frame] ** GAMMA)
        out += self.grain[row : row + height, column : column + width]
        out += np.float32(0.5)
        return np.clip(out, 0, 255, out=out).astype(np.uint8)
