"""Place recognition alone: images in, files out, and one line for whatever is wrong."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from place_recognition.paradigms.registry import PARADIGMS
from slam.cli import app
from slam.io.matches import read_matches
from slam.pipeline import place_recognition as places_drive

ROOT = Path(__file__).parents[3]
FILES = {"metrics.json", "matches.csv", "matrix.npz", "matrix.png", "precision_recall.csv", "precision_recall.png"}
LAP = 30


def views(seed: int) -> list[np.ndarray]:
    """A camera that slides past ever new blobs, LAP images."""
    rng = np.random.default_rng(seed)
    world = np.zeros((160, 1400), np.float32)
    for sigma in (1.5, 3.0, 6.0):
        layer = cv2.GaussianBlur(rng.normal(size=world.shape).astype(np.float32), (0, 0), sigma)
        world += layer / layer.std()
    grey = np.clip(128 + 30 * world, 0, 255).astype(np.uint8)
    return [grey[:, 36 * k : 36 * k + 240] for k in range(LAP)]


def write(folder: Path, images: list[np.ndarray]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f"{number}.png"), image)
    return folder


@pytest.fixture(scope="module")
def two_laps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("laps") / "hall", 2 * views(3))


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("truth") / "loops.npz"
    np.savez(path, truth=np.eye(2 * LAP, k=-LAP))
    return path


def places(source: Path, out: Path, *more: object, paradigm: str = "tracked-words") -> int:
    arguments = ["places", source, "--paradigm", paradigm, "--out", out, *more]
    return app._exit_code(lambda: app.app([str(argument) for argument in arguments]))


def metrics(out: Path) -> dict:
    return json.loads((out / "metrics.json").read_text())


@pytest.fixture(scope="module")
def evaluated(two_laps: Path, truth: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "run"
    assert places(two_laps, out, "--ground-truth", truth) == 0
    return out


def test_every_file_is_written_and_nothing_else(evaluated: Path) -> None:
    assert {path.name for path in evaluated.iterdir()} == FILES


def test_the_metrics_hold_what_scripts_read(evaluated: Path) -> None:
    found = metrics(evaluated)
    assert found["places"]["recall_at_100_precision"] > 0.8
    assert (found["places"]["truth_rows"], found["places"]["queries"], found["frames"]) == (LAP, 2 * LAP, 2 * LAP)
    assert found["places"]["words"] > 0
    assert found["places"]["map_bytes"] > 0
    assert set(found["timing_ms"]) == {"total", "read", "features", "place recognition"}
    assert found["frames_per_second"] > 0
    assert found["ground_truth"].endswith("loops.npz")


def test_the_matches_are_read_back_and_agree_with_the_metrics(evaluated: Path) -> None:
    beliefs = read_matches(evaluated / "matches.csv")
    places_section = metrics(evaluated)["places"]
    assert [belief.query for belief in beliefs] == list(range(2 * LAP))
    accepted = [belief for belief in beliefs if belief.accepted]
    assert len(accepted) == places_section["true_positives"] + places_section["false_positives"]
    with np.load(evaluated / "matrix.npz") as arrays:
        assert arrays["similarity"].shape == (2 * LAP, 2 * LAP)
        assert arrays["detections"].tolist() == [[b.query, b.match] for b in accepted]


def test_the_curve_ends_at_the_recall_of_all_detections(evaluated: Path) -> None:
    lines = (evaluated / "precision_recall.csv").read_text().splitlines()
    assert lines[0] == "threshold,precision,recall,true_positives,false_positives"
    thresholds = [float(line.split(",")[0]) for line in lines[1:]]
    assert thresholds == sorted(thresholds, reverse=True)


def test_without_a_truth_its_metrics_are_null_with_a_reason(two_laps: Path, tmp_path: Path) -> None:
    assert places(two_laps, tmp_path / "out") == 0
    found = metrics(tmp_path / "out")
    assert found["places"]["recall_at_100_precision"] is None
    assert found["notes"]["places.recall_at_100_precision"] == "there is no ground truth"
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES


def test_the_poses_of_a_kitti_drive_are_its_truth_under_a_declared_rule(tmp_path: Path) -> None:
    write(tmp_path / "sequences" / "00" / "image_0", 2 * views(3))
    (tmp_path / "sequences" / "00" / "times.txt").write_text("".join(f"{0.1 * k}\n" for k in range(2 * LAP)))
    angles = np.tile(np.linspace(0, 2 * np.pi, LAP, endpoint=False), 2)
    (tmp_path / "poses").mkdir()
    rows = [
        f"{np.cos(a)} 0 {np.sin(a)} {60 * np.cos(a)} 0 1 0 0 {-np.sin(a)} 0 {np.cos(a)} {-60 * np.sin(a)}"
        for a in angles
    ]
    (tmp_path / "poses" / "00.txt").write_text("\n".join(rows) + "\n")
    assert places(tmp_path, tmp_path / "out") == 0
    found = metrics(tmp_path / "out")
    assert found["places"]["truth_rows"] == LAP
    assert "within 10 m and 45 degrees, 20 m of path between" in found["ground_truth"]


def test_json_goes_to_standard_output_and_nothing_else_does(
    two_laps: Path, truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert places(two_laps, tmp_path / "out", "--ground-truth", truth, "--json") == 0
    assert json.loads(capsys.readouterr().out) == metrics(tmp_path / "out")


def test_excluded_images_are_not_matched(two_laps: Path, truth: Path, tmp_path: Path) -> None:
    assert places(two_laps, tmp_path / "out", "--ground-truth", truth, "--exclude", 20, "--fps", 1) == 0
    assert metrics(tmp_path / "out")["places"]["true_positives"] > 10
    assert places(two_laps, tmp_path / "more", "--ground-truth", truth, "--exclude", 40, "--fps", 1) == 0
    beliefs = read_matches(tmp_path / "more" / "matches.csv")
    assert all(belief.match is None or belief.query - belief.match >= 40 for belief in beliefs)


@pytest.mark.parametrize("paradigm", ["sequence-histograms", "dynamic-sequences", "hierarchical-places"])
def test_the_published_preset_excludes_40_s_by_the_times(
    two_laps: Path, truth: Path, tmp_path: Path, paradigm: str
) -> None:
    chosen = ("--preset", "published", "--ground-truth", truth, "--fps")
    assert places(two_laps, tmp_path / "out", *chosen, 1.6, paradigm=paradigm) == 0
    found = metrics(tmp_path / "out")
    assert (found["preset"], found["exclude_seconds"]) == ("published", 40.0)
    assert found["features"] == ("surf" if paradigm == "hierarchical-places" else "brief")
    assert matched(tmp_path / "out") == []
    assert places(two_laps, tmp_path / "more", *chosen, 0.7, paradigm=paradigm) == 0
    ages = [query - match for query, match in matched(tmp_path / "more")]
    assert len(ages) > 10
    assert min(ages) >= 28


def test_tracked_words_as_published_exclude_by_their_tracks_and_ask_for_no_times(
    two_laps: Path, truth: Path, tmp_path: Path
) -> None:
    assert places(two_laps, tmp_path / "out", "--preset", "published", "--ground-truth", truth) == 0
    found = metrics(tmp_path / "out")
    assert (found["preset"], found["exclude_seconds"]) == ("published", None)
    assert found["places"]["tolerance_10"]["true_positives"] > 10


def test_the_option_overrides_the_exclusion_of_the_preset(two_laps: Path, tmp_path: Path) -> None:
    chosen = ("--preset", "published", "--exclude")
    assert places(two_laps, tmp_path / "none", *chosen, 0, paradigm="hierarchical-places") == 0
    assert metrics(tmp_path / "none")["exclude_seconds"] == 0
    assert matched(tmp_path / "none")
    assert places(two_laps, tmp_path / "all", *chosen, 60, "--fps", 1, paradigm="hierarchical-places") == 0
    assert matched(tmp_path / "all") == []


def matched(out: Path) -> list[tuple[int, int]]:
    return [(belief.query, belief.match) for belief in read_matches(out / "matches.csv") if belief.match is not None]


@pytest.mark.parametrize("images", [1, 2])
def test_very_short_drives_match_nothing(tmp_path: Path, images: int) -> None:
    assert places(write(tmp_path / "short", views(1)[:images]), tmp_path / "out") == 0
    assert metrics(tmp_path / "out")["frames"] == images


@pytest.mark.parametrize("paradigm", PARADIGMS)
def test_black_images_and_changing_sizes_stop_nothing(tmp_path: Path, paradigm: str) -> None:
    images = [image if k % 4 else np.ascontiguousarray(image[:100, :150]) for k, image in enumerate(views(2)[:12])]
    images[5:7] = [np.zeros((160, 240), np.uint8)] * 2
    assert places(write(tmp_path / "odd", images), tmp_path / "out", paradigm=paradigm) == 0
    assert not any(belief.accepted for belief in read_matches(tmp_path / "out" / "matches.csv"))


def test_an_interruption_keeps_what_there_is(
    two_laps: Path, truth: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupting(images, factory, show_progress, should_stop):  # type: ignore[no-untyped-def]
        def interrupt_at_40(done: int, total: int) -> None:
            if done == 40:
                os.kill(os.getpid(), signal.SIGINT)

        return places_drive.run_recognizer(images, factory, interrupt_at_40, should_stop)

    monkeypatch.setattr("slam.apps.places.run_recognizer", interrupting)
    assert places(two_laps, tmp_path / "out", "--ground-truth", truth) == 130
    found = metrics(tmp_path / "out")
    assert (found["frames"], found["interrupted"], found["places"]["truth_rows"]) == (40, True, 10)
    assert len(read_matches(tmp_path / "out" / "matches.csv")) == 40


@pytest.mark.parametrize("features", ["sift", "orb"])
def test_other_features_find_the_places_too(two_laps: Path, truth: Path, tmp_path: Path, features: str) -> None:
    assert places(two_laps, tmp_path / "out", "--ground-truth", truth, "--features", features) == 0
    assert metrics(tmp_path / "out")["places"]["tolerance_10"]["recall_at_100_precision"] > 0.8


def test_words_of_other_features_serve_the_paradigms_that_need_words(
    two_laps: Path, truth: Path, tmp_path: Path
) -> None:
    elsewhere, words = write(tmp_path / "elsewhere", views(8)), tmp_path / "orb.vocabulary"
    train = ["vocabulary", "train", elsewhere, "--out", words, "--features", "orb", "--words", 300]
    assert app._exit_code(lambda: app.app([str(argument) for argument in train])) == 0
    chosen = ("--features", "orb", "--vocabulary", words, "--ground-truth", truth)
    assert places(two_laps, tmp_path / "out", *chosen, paradigm="sequence-histograms") == 0
    assert metrics(tmp_path / "out")["places"]["tolerance_10"]["recall_at_100_precision"] > 0.8


def damaged_vocabulary(folder: Path) -> Path:
    (folder / "x.vocabulary").write_bytes(b"no words")
    return folder / "x.vocabulary"


FAULTS: dict[str, tuple[Callable[[Path], list[object]], int, str]] = {
    "truth of another size": (lambda t: ["--ground-truth", saved(t, np.eye(9, k=-3))], 1, "expected a truth of 60"),
    "truth that is not square": (lambda t: ["--ground-truth", saved(t, np.ones((3, 4)))], 1, "expected a square truth"),
    "damaged truth": (lambda t: ["--ground-truth", garbage(t)], 1, "bad.npz: expected an intact .npz file"),
    "missing truth": (lambda t: ["--ground-truth", t / "none.mat"], 1, "none.mat: expected a truth file, found none"),
    "unknown paradigm": (lambda t: ["--paradigm", "guess"], 2, "unknown paradigm 'guess': expected one of"),
    "unknown features": (lambda t: ["--features", "brisk"], 2, "unknown local features 'brisk': expected one of surf"),
    "unknown preset": (lambda t: ["--preset", "chapter"], 2, "unknown preset 'chapter': expected one of default, pub"),
    "no times for the exclusion of a preset": (
        lambda t: ["--paradigm", "dynamic-sequences", "--preset", "published"], 2,
        "--preset published, which excludes 40 s: expected times.txt beside the images, found none; give --fps",
    ),
    "features without words": (
        lambda t: ["--paradigm", "dynamic-sequences", "--features", "sift"], 1, "revisit vocabulary train"
    ),
    "damaged vocabulary": (
        lambda t: ["--paradigm", "dynamic-sequences", "--vocabulary", damaged_vocabulary(t)], 1, "x.vocabulary"
    ),
    "no times for an exclusion": (lambda t: ["--exclude", 5], 2, "give --fps"),
    "an exclusion that is none": (lambda t: ["--exclude", -5], 2, "--exclude: expected seconds from 0, found -5"),
    "a rate that is none": (lambda t: ["--fps", 0], 2, "--fps: expected images per second, above 0"),
}  # fmt: skip


def saved(folder: Path, matrix: np.ndarray) -> Path:
    np.savez(folder / "other.npz", truth=matrix)
    return folder / "other.npz"


def garbage(folder: Path) -> Path:
    (folder / "bad.npz").write_bytes(b"PK\x03\x04 not really")
    return folder / "bad.npz"


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_one_line_and_leaves_earlier_results_alone(
    evaluated: Path, two_laps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str
) -> None:
    arguments, code, message = FAULTS[fault]
    before = {path.name: path.read_bytes() for path in evaluated.iterdir()}
    assert places(two_laps, evaluated, "--overwrite", *arguments(tmp_path)) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
    assert {path.name: path.read_bytes() for path in evaluated.iterdir()} == before


def test_earlier_results_are_not_overwritten_unasked(
    evaluated: Path, two_laps: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert places(two_laps, evaluated) == 1
    assert "--overwrite" in capsys.readouterr().err


def test_a_folder_without_images_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert places(tmp_path / "empty", tmp_path / "out") == 1
    assert "empty: expected images or a folder in KITTI layout, found neither" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_damaged_image_midway_is_named_and_nothing_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "hall", views(1)[:6])
    (folder / "4.png").write_bytes(b"no picture")
    assert places(folder, tmp_path / "out") == 1
    assert "4.png: expected an image" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


ALL_PARADIGMS = """
import sys, cv2
from slam.cli import app
cv2.setNumThreads(int(sys.argv[1]))
for paradigm in sys.argv[4:]:
    arguments = ["places", sys.argv[2], "--paradigm", paradigm, "--out", f"{sys.argv[3]}/{paradigm}"]
    if code := app._exit_code(lambda: app.app(arguments)):
        sys.exit(code)
"""


@pytest.fixture(scope="module")
def one_and_two_threads(two_laps: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folders with the results of all paradigms, of a process with one thread and of one with two."""
    outs = tmp_path_factory.mktemp("one"), tmp_path_factory.mktemp("two")
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    for threads, out in enumerate(outs, start=1):
        environment = os.environ | dict.fromkeys(names, str(threads)) | {"PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", ALL_PARADIGMS, str(threads), str(two_laps), str(out), *PARADIGMS]
        subprocess.run(command, check=True, capture_output=True, env=environment)
    return outs


@pytest.mark.parametrize("paradigm", PARADIGMS)
def test_any_number_of_threads_gives_the_same_bytes(one_and_two_threads: tuple[Path, Path], paradigm: str) -> None:
    one, two = (out / paradigm for out in one_and_two_threads)
    for name in ("matches.csv", "matrix.npz", "matrix.png"):
        assert (one / name).read_bytes() == (two / name).read_bytes()
