"""Make tests/data/rig_energies.npz, the motion energy of rig recordings: `python tests/make_rig_energies.py`.

Some minutes on one core.
"""

import tempfile
from pathlib import Path

import numpy as np

from recon.plush.capture import read_capture
from recon.rig.make import make_rig
from recon.rig.motion import SHAPES
from recon.rig.options import RigOptions
from recon.sync import motion_energy

STORE = Path(__file__).parent / "data/rig_energies.npz"
LENGTHS = (20, 48)  # frames
CAMERAS = 6


def main() -> None:
    """Film every shape in every length and keep what `veo inspect` compares."""
    energies = {}
    for shape in SHAPES:
        for frames in LENGTHS:
            options = RigOptions(shape=shape, cameras=CAMERAS, frames=frames, size=96, greys=False)
            with tempfile.TemporaryDirectory() as place:
                capture = read_capture(make_rig(Path(place) / shape, options))
                curves = [motion_energy(capture.sources[name].frames()) for name in capture.names]
            energies[f"{shape}/{frames}"] = np.round(np.stack(curves), 3).astype(np.float32)
            print(shape, frames, flush=True)
    np.savez_compressed(STORE, **energies)


if __name__ == "__main__":
    main()
