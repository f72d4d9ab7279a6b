"""The state of a running fit as one small file, so that an interrupted run goes on where it stopped."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from recon.files import replacing
from sim.fit import FitState


def write_state(path: Path, key: str, state: FitState) -> None:
    """Replace the checkpoint; key identifies the measurement and the options it belongs to."""
    with replacing(path) as partial:
        np.savez(partial, key=np.array(key), **{f.name: np.asarray(getattr(state, f.name)) for f in fields(state)})


def read_state(path: Path, key: str) -> FitState | None:
    """The state kept at path, or None when there is none, it is damaged, or belongs to something else."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            if str(stored["key"]) != key:
                return None
            return FitState(
                a=stored["a"], length=float(stored["length"]), amplitude=float(stored["amplitude"]),
                sigma=float(stored["sigma"]), y=stored["y"], objective=tuple(stored["objective"].tolist()),
                done=bool(stored["done"]), before=tuple(stored["before"].tolist()),
                settled=bool(stored["settled"]),
            )  # fmt: skip
    except (OSError, ValueError, KeyError, EOFError):
        return None
