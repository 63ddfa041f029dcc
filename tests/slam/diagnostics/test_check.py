"""What is wrong with a recording is found before the run, and what can still be done with it is said."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.cli import app
from slam.datasets.dataset import DatasetSpec
from slam.diagnostics.dataset_checks import inspect_dataset
from slam.diagnostics.findings import Finding, Inspection, Status, Use

from ..datasets.layouts import RATE, BagStyle, Taken, taken, write_bag, write_folders
from ..datasets.rig import Rig

Image = np.ndarray


@pytest.fixture(scope="module")
def ideal() -> Taken:
    return taken("ideal", 6)


def checked(path: Path) -> Inspection:
    return inspect_dataset(DatasetSpec(path), lambda done, total: None)


def found(inspection: Inspection, status: Status) -> dict[str, Finding]:
    return {finding.topic: finding for finding in inspection.findings if finding.status is status}


def seen_through(drive: Taken, change: Callable[[int, Image], Image]) -> Taken:
    """The same drive, each image changed by its number."""
    return replace(drive, pairs=[(change(k, left), change(k, right)) for k, (left, right) in enumerate(drive.pairs)])


def described(drive: Taken, **numbers: float) -> Taken:
    """The same images, whose left camera is described by other numbers than it has."""
    lens = replace(drive.rig.left, **numbers)
    return replace(drive, rig=Rig(lens, lens, drive.rig.T_left_right))


def test_a_good_pair_serves_for_everything(tmp_path: Path, ideal: Taken) -> None:
    inspection = checked(write_folders(tmp_path, ideal, fps=RATE))
    assert inspection.possible_uses == tuple(Use)
    assert {finding.status for finding in inspection.findings} == {Status.OK}
    rows = found(inspection, Status.OK)["rows"].figures
    assert rows["median_px"] < 0.2
    assert rows["matches"] > 200


def test_a_distorted_pair_is_good_once_it_is_described(tmp_path: Path) -> None:
    bent = taken("radtan", 3)
    assert checked(write_folders(tmp_path / "described", bent, fps=RATE)).possible_uses == tuple(Use)
    # the same images, said to be ideal by someone who has measured nothing but the baseline
    folder = write_folders(tmp_path / "guessed", bent)
    (folder / "camera.toml").write_text("fx=200\nfy=200\ncx=160\ncy=120\nbaseline=0.11\nfps=20\n")
    inspection = checked(folder)
    assert "px off the common row" in found(inspection, Status.FAULT)["rows"].text
    assert inspection.possible_uses == (Use.MONO, Use.PLACES)


TROUBLE: dict[str, tuple[Callable[[int, Image], Image], str, Status]] = {
    "dark": (lambda k, image: image // 12, "dark", Status.FAULT),
    "glaring": (lambda k, image: np.clip(image * 3.0, 0, 255).astype(np.uint8), "over-exposed", Status.FAULT),
    "dark at times": (lambda k, image: image // 12 if k % 4 == 0 else image, "dark", Status.WARNING),
    "covered": (lambda k, image: np.full_like(image, 127) if k in (2, 3) else image, "blank", Status.WARNING),
}


@pytest.mark.parametrize("trouble", TROUBLE)
def test_bad_light_is_seen(tmp_path: Path, ideal: Taken, trouble: str) -> None:
    change, word, status = TROUBLE[trouble]
    inspection = checked(write_folders(tmp_path, seen_through(ideal, change), fps=RATE))
    assert any(word in finding.text for finding in inspection.findings if finding.status is status)
    assert bool(inspection.possible_uses) == (status is not Status.FAULT)


def test_repeated_images_are_seen(tmp_path: Path, ideal: Taken) -> None:
    often = replace(ideal, pairs=[ideal.pairs[k // 2] for k in range(6)])
    doubtful = found(checked(write_folders(tmp_path, often, fps=RATE)), Status.WARNING)
    assert doubtful["repetitions"].figures["share"] == pytest.approx(3 / 5)


NUMBERS: dict[str, tuple[dict[str, float], str, Status]] = {
    "focal length of another size": ({"fx": 26.0, "fy": 26.0}, "field of view", Status.WARNING),
    "focal length of no camera": ({"fx": 0.26, "fy": 0.26}, "field of view", Status.FAULT),
    "centre of another size": ({"cx": 255.0, "cy": 118.0}, "principal point", Status.WARNING),
    "centre outside of the image": ({"cx": 640.0, "cy": 360.0}, "principal point", Status.FAULT),
    "pixels that are not square": ({"fx": 260.0, "fy": 195.0}, "pixels", Status.WARNING),
}


@pytest.mark.parametrize("trouble", NUMBERS)
def test_numbers_of_no_camera_are_seen(tmp_path: Path, ideal: Taken, trouble: str) -> None:
    numbers, topic, status = NUMBERS[trouble]
    inspection = checked(write_folders(tmp_path, described(ideal, **numbers), fps=RATE))
    assert topic in found(inspection, status)
    assert inspection.possible_uses == (tuple(Use) if status is Status.WARNING else (Use.PLACES,))


def test_a_baseline_in_millimetres_is_seen(tmp_path: Path, ideal: Taken) -> None:
    folder = write_folders(tmp_path, ideal)
    (folder / "camera.toml").write_text("fx=260\nfy=260\ncx=160\ncy=118\nbaseline=300\nfps=20\n")
    text = found(checked(folder), Status.WARNING)["baseline"].text
    assert "is it in metres? It is 0.300 m if millimetres were given: correct the calibration" in text


def test_cameras_that_are_swapped_are_seen_in_the_images(tmp_path: Path, ideal: Taken) -> None:
    swapped = replace(ideal, pairs=[(right, left) for left, right in ideal.pairs])
    inspection = checked(write_folders(tmp_path, swapped, fps=RATE))
    assert "swap left and right" in found(inspection, Status.FAULT)["rows"].text
    assert Use.STEREO not in inspection.possible_uses


def test_a_pause_and_a_slow_camera_are_seen(tmp_path: Path, ideal: Taken) -> None:
    folder = write_folders(tmp_path, ideal)
    (folder / "times.txt").write_text("".join(f"{k / 2 + (k > 3) * 9}\n" for k in range(6)))
    doubtful = found(checked(folder), Status.WARNING)
    assert "1, the longest of 9.50 s after image 3" in doubtful["pauses"].text
    assert doubtful["rate"].figures["rate_hz"] == 2.0


def test_one_camera_serves_for_one(tmp_path: Path, ideal: Taken) -> None:
    folder = write_folders(tmp_path, ideal)
    (folder / "camera.toml").write_text("fx=260\nfy=260\ncx=160\ncy=118\nfps=20\n")
    inspection = checked(folder)
    assert inspection.possible_uses == (Use.MONO, Use.PLACES)
    assert "the left camera alone is used" in found(inspection, Status.WARNING)["reading"].text


def test_images_without_calibration_serve_for_places(tmp_path: Path, ideal: Taken) -> None:
    folder = write_folders(tmp_path, ideal)
    (folder / "camera.toml").unlink()
    inspection = checked(folder)
    assert inspection.possible_uses == (Use.PLACES,)
    assert "expected the calibration of the camera" in inspection.reasons_against(Use.STEREO)[0]


def test_an_image_that_cannot_be_read_stops_everything_and_is_named(tmp_path: Path, ideal: Taken) -> None:
    folder = write_folders(tmp_path, ideal, fps=RATE)
    (folder / "left" / "11.png").write_bytes(b"no image")
    inspection = checked(folder)
    assert inspection.possible_uses == ()
    assert "11.png: expected an image" in inspection.reasons_against(Use.PLACES)[0]


def revisit(*arguments: object) -> int:
    return app._exit_code(lambda: app.app([str(argument) for argument in arguments]))


def test_the_command_answers_people_and_scripts(
    tmp_path: Path, ideal: Taken, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_folders(tmp_path / "mine", ideal, fps=RATE)
    assert revisit("check", folder) == 0
    assert "revisit run: will work" in capsys.readouterr().out
    assert revisit("check", folder, "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["format"], answer["works"]) == ("own-camera", {"stereo": True, "mono": True, "places": True})
    for file in (folder / "right").iterdir():
        file.write_bytes(b"")
    assert revisit("check", folder, "--json") == 0
    assert json.loads(capsys.readouterr().out)["works"] == {"stereo": False, "mono": True, "places": True}
    for file in (folder / "left").iterdir():
        file.write_bytes(b"")
    assert revisit("check", folder) == 1
    assert "will not work: " in capsys.readouterr().out
    assert revisit("check", tmp_path / "nowhere") == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_topics_of_a_bag_are_chosen_on_the_command_line(
    tmp_path: Path, ideal: Taken, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path, ideal, BagStyle("mcap", topics=("/a/image", "/b/image")))
    assert revisit("check", bag) == 1
    assert "choose with --image-topic" in capsys.readouterr().out.replace("\n", " ")
    assert revisit("check", bag, "--image-topic", "/a/image", "--image-topic", "/b/image", "--json") == 0
    assert json.loads(capsys.readouterr().out)["works"]["stereo"]
    assert revisit("check", bag, "--format", "mcap") == 2
    assert "--format: expected one of bag, " in capsys.readouterr().err


def test_a_real_drive_is_good(test_data: Path) -> None:
    inspection = inspect_dataset(DatasetSpec(test_data / "kitti_clips", "06"), lambda done, total: None)
    assert inspection.possible_uses == tuple(Use)
    assert found(inspection, Status.OK)["rows"].figures["median_px"] < 0.5
