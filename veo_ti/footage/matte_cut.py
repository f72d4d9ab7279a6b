"""How one camera's frames are cut: by plate or brightness or a network, and without the nozzle where it is known."""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from recon.cameras import Camera
from recon.mattes.masks import MaskOptions
from recon.mattes.matting import MattingOptions, matte
from recon.mattes.network import Session, network_matte, open_network
from recon.mattes.nozzle import without_nozzle
from sim.checks import require

Markers = tuple[np.ndarray | None, ...]  # T_world_marker by frame


@dataclass(frozen=True, kw_only=True)
class MatteChoice:
    """How the object is told from the rest.

    plate_frame: frames without the object, "12" or "0-30"; plates: a folder with the empty scene; network: an .onnx
    file; threshold: of 255, in place of the background's own noise; quick: hard edges, at a fortieth of the time;
    nozzle: leave it in the mattes.
    """

    plate_frame: str | None = None
    plates: Path | None = None
    network: Path | None = None
    threshold: float | None = None
    quick: bool = False
    nozzle: bool = False

    @property
    def options(self) -> MattingOptions:
        """For `recon.mattes.matting.matte`; raises ValueError for a threshold that is none."""
        return MattingOptions(mask=MaskOptions(threshold=self.threshold), closed_form=not self.quick)

    @property
    def session(self) -> Session | None:
        """The network, opened; raises ValueError when it cannot be, or other settings contradict it."""
        if self.network is None:
            return None
        plain = self.threshold is None and not self.quick
        require(plain, "--network", "be given without --threshold and --quick", "both")
        try:
            return open_network(self.network)
        except RuntimeError as error:  # onnxruntime is missing
            raise ValueError(str(error)) from None


@dataclass(frozen=True, kw_only=True, eq=False)
class Cutter:
    """All that decides a camera's mattes; camera and markers: where the nozzle is, None and () where nobody knows."""

    plate: np.ndarray | None
    options: MattingOptions
    session: Session | None = None
    camera: Camera | None = None
    markers: Markers = ()

    def __call__(self, frame: int, image: np.ndarray) -> np.ndarray:
        """The matte (H, W) in [0, 1] of a frame's picture (H, W[, 3]) uint8."""
        if self.session is None:
            whole = matte(image, self.plate, options=self.options)
        else:
            whole = network_matte(self.session, image, self.plate)
        known = self.camera is not None and frame < len(self.markers) and self.markers[frame] is not None
        return without_nozzle(whole, self.camera, self.markers[frame]) if known else whole

    @property
    def parts(self) -> tuple[object, ...]:
        """What the mattes depend on, but for the pictures and the network, for a fingerprint."""
        nothing = np.zeros((4, 4))
        plate = nothing if self.plate is None else self.plate
        parts = (self.plate is None, plate, self.options)
        if self.camera is None:
            return parts
        poses = np.array([nothing if T is None else T for T in self.markers])
        return (*parts, self.camera.K, self.camera.distortion, self.camera.T_camera_world, poses)


def file_digest(path: Path | None) -> str:
    """Of a file's bytes; of no file at all, nothing."""
    return "" if path is None else sha256(Path(path).read_bytes()).hexdigest()
