"""How long and how fast a field is trained."""

from dataclasses import dataclass, field

from recon.radiance.fields import FieldOptions
from recon.radiance.losses import LossWeights
from sim.checks import require

_CANONICAL_END = 0.1  # of its rate, that the canonical field has when the motion begins
_STILL_END = 0.2  # likewise, at the end where no motion follows
_END = 0.05  # of their rates, that all have at the end of the motion


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Steps of both stages, samples a step, learning rates at their start, weights of losses.

    ramp: share of the motion stage over which frames join; pulling: levels of the hash grid whose derivative bends rays
    meanwhile; cells: of the hulls along the longest side; canonical_share: of its first rate, for the canonical field
    in the motion stage; canonical_frames: how many first frames, of an object still at rest, the canonical stage sees.
    """

    canonical_steps: int = 600
    canonical_frames: int = 1
    motion_steps: int = 2000
    samples: int = 1 << 15
    weights: LossWeights = field(default_factory=LossWeights)
    field: FieldOptions = field(default_factory=FieldOptions)  # last of these: it hides dataclasses.field
    field_rate: float = 4e-2
    bending_rate: float = 3e-3
    latent_rate: float = 7e-3
    canonical_share: float = 0.1
    ramp: float = 0.5
    pulling: int = 5
    cells: int = 96
    seed: int = 0

    def __post_init__(self) -> None:
        counts = min(self.canonical_steps, self.canonical_frames, self.samples, self.pulling) >= 1
        require(counts and self.motion_steps >= 0, "steps, frames, samples and pulling", "be positive", self)
        rates = min(self.field_rate, self.bending_rate, self.latent_rate) > 0 and 0 < self.ramp <= 1
        require(rates and self.canonical_share >= 0, "rates", "be in range", self)

    def steps(self, frames: int) -> int:
        """Of both stages; one frame has no motion."""
        return self.canonical_steps + self.motion_steps * (frames > 1)

    def rates(self, step: int, frames: int) -> dict[str, float]:
        """Of the canonical field, the latents and all others, by the step alone, never by the clock."""
        if step >= self.canonical_steps:
            late = max(0.0, (self.moved(step) - self.ramp) / max(1 - self.ramp, 1e-9))
            fade, field = _END**late, self.canonical_share * self.field_rate
        else:
            end = _CANONICAL_END if self.steps(frames) > self.canonical_steps else _STILL_END
            fade, field = 1.0, self.field_rate * end ** (step / self.canonical_steps)
        rates = {"field": field, "latents": self.latent_rate, "others": self.bending_rate}
        return {name: fade * rate for name, rate in rates.items()}

    def moved(self, step: int) -> float:
        """Share of the motion stage that is done."""
        return (step - self.canonical_steps) / max(self.motion_steps, 1)
