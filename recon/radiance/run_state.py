"""All that changes while a field is trained, and the checkpoint it goes on from after an interruption."""

import copy
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch

from recon.files import replacing
from recon.radiance.fields import Dynamic

_NUMBERS = ("step", "rays", "slower", "restarts", "mean", "best", "averaged")


@dataclass(kw_only=True, eq=False)
class Run:
    """All that changes while training, and that a checkpoint holds."""

    model: Dynamic
    gains: torch.nn.Parameter  # (C, 2): of each camera's grey pictures, gain and bias
    optimiser: torch.optim.Optimizer
    generator: torch.Generator
    step: int = 0
    rays: int = 1024
    slower: float = 1.0  # factor on all rates, after restarts
    restarts: int = 0
    mean: float = math.inf  # running mean of the loss
    best: float = math.inf
    averaged: int = 0  # states of the model in the average

    @cached_property
    def average(self) -> Dynamic:
        """The mean of the model's states that were taken in (Izmailov et al. 2018)."""
        return copy.deepcopy(self.model)

    @property
    def learnt(self) -> Dynamic:
        """The average, once there is one."""
        return self.average if self.averaged else self.model

    @torch.no_grad()
    def take_in(self) -> None:
        """Take the model as it is into the average."""
        self.averaged += 1
        for mean, own in zip(self.average.parameters(), self.model.parameters(), strict=True):
            mean.lerp_(own, 1 / self.averaged)

    def state(self) -> dict[str, object]:
        """Everything, as tensors and numbers."""
        return {
            "model": self.model.state_dict(), "average": self.average.state_dict(),
            "gains": self.gains.detach().clone(), "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(), **{name: getattr(self, name) for name in _NUMBERS},
        }  # fmt: skip

    def load(self, state: dict) -> None:
        """Become what `state` says."""
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        with torch.no_grad():
            self.gains.copy_(state["gains"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["generator"])
        for name in _NUMBERS:
            setattr(self, name, state[name])

    def save(self, path: Path, made_from: str) -> None:
        """Write a checkpoint; `made_from` tells what it may go on with."""
        with replacing(path) as partial:
            torch.save({"made_from": made_from, **self.state()}, partial)

    def resume(self, path: Path, made_from: str) -> bool:
        """Go on from a checkpoint if there is one of the same inputs; nothing in it is unpickled but tensors."""
        if not path.exists():
            return False
        try:
            state = torch.load(path, weights_only=True, map_location="cpu")
        except (RuntimeError, EOFError, ValueError) as error:
            raise ValueError(f"{path.name} must be a checkpoint; got a damaged file: {error}") from None
        if state.get("made_from") != made_from:
            return False
        self.load(state)
        return True
