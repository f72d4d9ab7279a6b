"""What every test may ask for: measured data where it is present, a software renderer in place of OpenGL."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from recon.radiance import device
from sim.runtime import ensure

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("DEPTHAI_INSTALL_SIGNAL_HANDLER", "0")  # its handler would hide where the process crashed
ROOT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--device", help="what the kernels run on: cpu or cuda")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--device"):
        device.use(config.getoption("--device"))
    elif "PYTEST_XDIST_WORKER" in os.environ:
        ensure(threads=1)  # others run beside this one


@pytest.fixture
def measured() -> Callable[[str], Path]:
    """The path of a file of the measured data ($VEO_DATA, default ../shared/data); skips where it is absent."""

    def find(name: str) -> Path:
        path = ROOT / os.environ.get("VEO_DATA", "../shared/data") / name
        if not path.exists():
            pytest.skip(f"{name} is not in the measured data; set VEO_DATA to its folder")
        return path

    return find
