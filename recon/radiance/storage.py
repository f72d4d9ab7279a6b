"""A trained field in one file: tensors and plain values, so that reading it runs nothing."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from recon.files import replacing
from recon.radiance.device import array, device
from recon.radiance.fields import Box, Dynamic, FieldOptions
from recon.radiance.hashgrid import HashGrid
from recon.radiance.marching import Occupancy
from recon.radiance.training import Trained
from sim.checks import require

VERSION = 3


def save_trained(path: str | Path, trained: Trained, options: FieldOptions) -> Path:
    """Write a field with its box, its occupancy and how its training ended; options: those it was made with."""
    told = {
        "version": VERSION, "options": asdict(options), "frames": len(trained.field.latents),
        "latent": trained.field.latents.shape[1], "side": trained.box.side, "spacing": trained.occupancy.spacing,
        "status": trained.status, "sentence": trained.sentence, "made_from": trained.made_from,
    }  # fmt: skip
    held = {
        "told": json.dumps(told), "field": trained.field.state_dict(), "origin": torch.from_numpy(trained.box.origin),
        "cells": trained.occupancy.cells, "corner": trained.occupancy.origin,
    }  # fmt: skip
    with replacing(path) as partial:
        torch.save(held, partial)
    return Path(path)


def load_trained(path: str | Path) -> Trained:
    """Raises ValueError for a file that is missing, damaged, or of another kind or version."""
    path = Path(path)
    require(path.is_file(), "field", "be a file that veo reconstruct wrote", repr(str(path)))
    try:
        held = torch.load(path, weights_only=True, map_location=device())
        told = json.loads(held["told"])
    except Exception as error:  # torch raises many kinds for what is no file of its own
        raise ValueError(f"{path.name} must be a field that veo reconstruct wrote; got {error}") from None
    require(told["version"] == VERSION, path.name, f"be of version {VERSION}", told["version"])
    options = told["options"]
    options = FieldOptions(**{**options, "grid": HashGrid(**options["grid"])})
    box = Box(origin=array(held["origin"]).astype(np.float64), side=told["side"])
    field = Dynamic(box, told["frames"], options, latent=told["latent"]).to(device())
    field.load_state_dict(held["field"])
    occupancy = Occupancy(cells=held["cells"], origin=held["corner"], spacing=told["spacing"])
    ended = {name: told[name] for name in ("status", "sentence", "made_from")}
    return Trained(field=field.eval(), box=box, occupancy=occupancy, **ended)
