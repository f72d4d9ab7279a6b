"""The description of a rig: what a person may write, and what is refused, in one sentence that names the camera."""

import json
from dataclasses import replace

import pytest

from recon.oak.spec import MOST_DEVICES, StreamSpec, default_rig, load_rig, rig_of, save_rig

PLAIN = {"stream": "colour", "socket": "CAM_A", "size": [1920, 1080]}


def rig(stream=None, device=None, **options):
    """A rig of one device with one stream, as parsed JSON, with the given changes."""
    entry = {"name": "cam0001", "streams": [{**PLAIN, **(stream or {})}], **(device or {})}
    return {"devices": [entry], **options}


@pytest.mark.parametrize("count", [1, 2, MOST_DEVICES])
def test_default_rig_is_the_plush_one_and_survives_its_file(tmp_path, count):
    spec = default_rig(count)
    names = [name for device in spec.devices for name, _ in device.named()]
    assert len(names) == 3 * count and names[:3] == ["cam0001", "cam0001.left", "cam0001.right"]
    assert spec.fps == 40 and spec.devices[-1].streams[0].size == (1920, 1080) and spec.sync_frames == 0.5
    assert load_rig(save_rig(spec, tmp_path / "rig.json")) == spec


def test_ids_and_everything_set_by_hand_survive_the_file(tmp_path):
    spec = default_rig(["1844A", "1844B"])
    stream = StreamSpec(
        stream="colour", socket="CAM_D", size=(1280, 720), exposure_us=4000, iso=400, focus=120, white_balance_k=5600
    )
    device = replace(spec.devices[0], streams=(stream,), turned_deg=0, role="nozzle", frame_sync="output")
    spec = replace(spec, devices=(device, spec.devices[1]), fps=30.0, bitrate_mbit=None, quality=80, sync_frames=1.0)
    assert load_rig(save_rig(spec, tmp_path / "rig.json")) == spec


def test_what_has_a_default_may_be_left_out():
    spec = rig_of(rig())
    assert spec.devices[0].streams[0] == StreamSpec(stream="colour", socket="CAM_A", size=(1920, 1080))
    assert (spec.fps, spec.devices[0].turned_deg, spec.devices[0].device) == (40.0, 90, None)


WRONG = {
    "unknown socket": (rig({"socket": "CAM_Q"}), "cam0001 colour socket must be one of CAM_A, .*; got 'CAM_Q'"),
    "unsupported width": (rig({"size": [1900, 1080]}), "cam0001 colour size must be a width in steps of 32 and a"),
    "unsupported height": (rig({"size": [1920, 1084]}), "cam0001 colour size must be a width in steps of 32 and a"),
    "too large": (rig({"size": [8192, 1080]}), r"colour size must be .*, 64 to 4096 pixels; got \[8192, 1080\]"),
    "size of words": (rig({"size": "1080p"}), "cam0001 stream size must be a list; got '1080p'"),
    "size of three": (rig({"size": [32, 8, 3]}), r"cam0001 colour size must be .*; got \[32, 8, 3\]"),
    "unknown stream": (rig({"stream": "depth"}), r"cam0001 stream must be one of \('colour', 'left', 'right'\)"),
    "iso alone": (rig({"iso": 400}), "cam0001 colour exposure_us and iso must be given together; got None and 400"),
    "too bright": (rig({"iso": 9000, "exposure_us": 100}), "colour iso must lie between 100 and 1600; got 9000"),
    "too long": (
        rig({"iso": 400, "exposure_us": 30000}),
        "cam0001 exposure_us must fit into one frame of 25000; got 30000",
    ),
    "true is no number": (rig({"iso": True}), "cam0001 stream iso must be a whole number or null; got True"),
    "focus": (rig({"focus": 256}), "cam0001 colour focus must be one of .* or a lens position 0 to 255; got 256"),
    "name": (rig(device={"name": "left"}), "device name must look like cam0001; got 'left'"),
    "turn": (rig(device={"turned_deg": 45}), "cam0001 turned_deg must be one of .*; got 45"),
    "role": (rig(device={"role": "spare"}), "cam0001 role must be one of .*; got 'spare'"),
    "frame sync": (rig(device={"frame_sync": "on"}), "cam0001 frame_sync must be one of .*; got 'on'"),
    "no streams": (rig(device={"streams": []}), "cam0001 streams must be 1 to 3; got 0"),
    "socket twice": (
        rig(device={"streams": [PLAIN, {**PLAIN, "stream": "left"}]}),
        "cam0001 sockets must differ from one another; got CAM_A, CAM_A",
    ),
    "misspelt key": (rig(frames=40), "rig keys must be among devices, fps, .*; got frames"),
    "missing key": ({"devices": [{"streams": [PLAIN]}]}, "device 1 must have the keys name; got only streams"),
    "fps": (rig(fps=0), "fps must lie between 1 and 120; got 0"),
    "NaN": (rig(fps=float("nan")), "fps must lie between 1 and 120; got nan"),
    "fps of words": (rig(fps="40"), "rig fps must be a number; got '40'"),
    "sync": (rig(sync_frames=1.5), "sync_frames must lie above 0 and up to 1; got 1.5"),
    "bitrate": (rig(bitrate_mbit=-1), "bitrate_mbit must lie above 0 and up to 200, or be null; got -1"),
    "more than the encoder does": (
        rig({"size": [3840, 2160]}, fps=40),
        "cam0001 streams must stay below 248 million pixels a second, .*; got 332 million",
    ),
    "same name": ({"devices": 2 * rig()["devices"]}, "device names must differ from one another; got cam0001 twice"),
    "no devices": ({"devices": []}, "devices must be 1 to 19; got 0"),
    "no list": ({"devices": 3}, "rig devices must be a list; got 3"),
    "no rig": ([], "rig must be an object with keys and values; got list"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_spec_is_one_sentence_that_names_file_and_camera(tmp_path, case):
    held, sentence = WRONG[case]
    (tmp_path / "rig.json").write_text(json.dumps(held))
    with pytest.raises(ValueError, match=f"^rig.json: .*{sentence}") as caught:
        load_rig(tmp_path / "rig.json")
    assert "\n" not in str(caught.value)


def test_file_that_is_missing_or_no_json_is_one_sentence(tmp_path):
    with pytest.raises(ValueError, match=r"rig\.json must be a readable JSON file"):
        load_rig(tmp_path / "rig.json")
    (tmp_path / "rig.json").write_text("{")
    with pytest.raises(ValueError, match=r"rig\.json must be a readable JSON file"):
        load_rig(tmp_path / "rig.json")
