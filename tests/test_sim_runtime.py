"""Taichi is started once, in 64 bits, silently; BLAS can be held to one thread."""

import subprocess
import sys

import numpy as np
import pytest
import taichi as ti
from threadpoolctl import threadpool_info

from sim import runtime


def test_second_start_keeps_what_the_first_one_made():
    runtime.ensure()
    field = ti.field(ti.f64, shape=3)
    field.from_numpy(np.arange(3.0))
    runtime.ensure()
    assert (field.to_numpy() == np.arange(3.0)).all()


def test_floats_are_64_bits():
    runtime.ensure()
    assert ti.lang.impl.get_runtime().default_fp == ti.f64


def test_unknown_architecture_is_refused():
    with pytest.raises(ValueError, match=r"arch must be one of .*got 'tpu'"):
        runtime.ensure("tpu")


def test_another_architecture_than_the_running_one_is_refused():
    code = """if True:
        import sim.runtime
        sim.runtime.ensure()
        try:
            sim.runtime.ensure("cuda")
        except RuntimeError as fault:
            print(sim.runtime.running(), fault)
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("cpu Taichi runs on cpu; cuda must be there, and be asked for before anything else")


def test_start_prints_nothing():
    code = "import sim.runtime; sim.runtime.ensure(threads=1)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_callers_32_bit_taichi_is_refused():
    """Without the end of a Taichi that is not ours: once, a bus error came there, after all had been said."""
    code = """if True:
        import os, taichi as ti, sim.runtime
        ti.init(ti.cpu)
        try:
            sim.runtime.ensure()
        except RuntimeError as fault:
            print(fault, flush=True)
            os._exit(0)
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Taichi already runs with 32-bit floats" in done.stdout


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_serial_blas_holds_blas_to_one_thread_and_gives_it_back():
    before = blas_threads()
    with runtime.serial_blas():
        assert blas_threads() == {1}
    assert blas_threads() == before
