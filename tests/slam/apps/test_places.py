"""Place recognition alone: images in, files out, and one line for whatever is wrong."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from odometry import se3
from place_recognition.image_processing.local_features import FeatureCache, LocalFeatures
from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig
from place_recognition.recognizer import Belief, StageScores
from slam.apps.places import drop_recent_matches
from slam.cli import app
from slam.io.matches import read_matches
from slam.io.trajectory_files import write_tum
from slam.pipeline import place_recognition as places_drive

ROOT = Path(__file__).parents[3]
FILES = {
    "metrics.json",
    "matches.csv",
    "matrix.npz",
    "matrix.png",
    "precision_recall.csv",
    "precision_recall.png",
    "stages.png",
}
LAP = 30


class LoadedImages(list[np.ndarray]):
    """Images in memory, as a recording."""

    name = "hall"


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


def test_the_control_is_measured_beside_the_recogniser(evaluated: Path) -> None:
    section = metrics(evaluated)["places"]
    assert section["control"]["what"].startswith("random-images")
    assert set(section["stages"]) == set(section["control"]) - {"what"}
    assert 0.0 < section["control"]["candidates"]["recall_at_10"] < 0.8
    ours, theirs = (section[part]["temporal"]["recall_at_100_precision"] for part in ("stages", "control"))
    assert ours == section["recall_at_100_precision"] > theirs
    assert section["events"]["count"] == section["events"]["found"] == 1


def test_the_seed_decides_what_the_control_proposes(two_laps: Path, truth: Path, tmp_path: Path) -> None:
    found = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        assert places(two_laps, tmp_path / name, "--ground-truth", truth, "--seed", seed) == 0
        found.append(metrics(tmp_path / name)["places"]["control"])
    assert found[0] == found[1] != found[2]


@pytest.mark.parametrize("paradigm", PARADIGMS)
def test_the_control_changes_nothing_of_the_recogniser(paradigm: str) -> None:
    images = LoadedImages(2 * views(3))
    alone, beside = (
        places_drive.run_recognizer(
            images, places_drive.RecognizerFactory(paradigm, ParadigmsConfig(), seed), lambda *_: None, lambda: False
        )
        for seed in (None, 7)
    )
    assert alone.beliefs == beside.beliefs
    assert alone.control is None
    assert beside.control is not None
    assert len(beside.control) == 2 * LAP


class SlowControl:
    """A control that takes its time and asks for features that nobody else needs."""

    def __init__(self, features: FeatureCache) -> None:
        self.features = features

    def observe(self, image_id: int, image: np.ndarray, travelled: float) -> list[Belief]:
        time.sleep(0.05)
        self.features.get(image_id + 1000, image)
        return [Belief(image_id, None, 0.0, accepted=False)]

    def finish(self) -> list[Belief]:
        time.sleep(0.5)
        return []


def test_the_time_of_the_control_is_not_that_of_the_paradigm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places_drive, "build_control", lambda features, config, seed: SlowControl(features))
    factory = places_drive.RecognizerFactory("pixel-sequences", ParadigmsConfig(), 0)
    start = time.perf_counter()
    run = places_drive.run_recognizer(LoadedImages(views(3)), factory, lambda *_: None, lambda: False)
    assert time.perf_counter() - start > run.wall_seconds + LAP * 0.05 + 0.5
    assert {name for spent in run.stage_ms for name in spent} == {"read", "features", "place recognition"}


class CountingExtractor:
    """Counts how often an image is described."""

    kind = "none-8"

    def __init__(self) -> None:
        self.count = 0

    def extract(self, image: np.ndarray, mask: np.ndarray | None = None) -> LocalFeatures:
        self.count += 1
        return LocalFeatures(*(np.empty(shape, np.float32) for shape in ((0, 2), 0, 0, (0, 8))))


def test_the_control_shares_the_features_of_each_image(monkeypatch: pytest.MonkeyPatch) -> None:
    extractor = CountingExtractor()
    monkeypatch.setattr(places_drive, "build_extractor", lambda config: extractor)
    monkeypatch.setattr(places_drive, "_WARM_UP_IMAGES", 0)
    factory = places_drive.RecognizerFactory("tracked-words", ParadigmsConfig(), 0)
    places_drive.run_recognizer(LoadedImages(views(3)), factory, lambda *_: None, lambda: False)
    assert extractor.count == LAP


def test_the_summary_fits_into_100_columns_and_names_the_stages(
    two_laps: Path, truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert places(two_laps, tmp_path / "out", "--ground-truth", truth, "--fps", 1) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.split("Pictures:")[0].splitlines())) <= 100
    for words in (
        "candidates",
        "own score",
        "geometry",
        "temporal model",
        "random images",
        "revisit events: 1 of 1 found",
    ):
        assert words in printed


def test_a_candidate_that_is_too_recent_goes_with_its_score() -> None:
    images = SimpleNamespace(timestamps=np.arange(60.0))
    stages = StageScores((45, 20), 3.0, 45, 9.0)
    recent, old = (Belief(50, match, 1.0, True, stages=stages, answered_at=52) for match in (45, 20))
    kept = drop_recent_matches([recent, old], images, 10.0)  # type: ignore[arg-type]
    only = StageScores((20,), None, None, None)
    assert kept == [
        Belief(50, None, 0.0, False, stages=only, answered_at=52),
        Belief(50, 20, 1.0, True, stages=only, answered_at=52),
    ]
    assert drop_recent_matches([recent], images, None) == [recent]  # type: ignore[arg-type]


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
    def interrupting(images, factory, show_progress, should_stop, reference):  # type: ignore[no-untyped-def]
        def interrupt_at_40(done: int, total: int) -> None:
            if done == 40:
                os.kill(os.getpid(), signal.SIGINT)

        return places_drive.run_recognizer(images, factory, interrupt_at_40, should_stop, reference)

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
    for name in ("matches.csv", "matrix.npz", "matrix.png", "stages.png"):
        assert (one / name).read_bytes() == (two / name).read_bytes()


@pytest.fixture
def painted(two_laps: Path, tmp_path: Path) -> Path:
    """The two laps with the same textured strip at the bottom of each image."""
    strip = views(8)[0][:50]
    images = [cv2.imread(str(two_laps / f"{k}.png"), 0) for k in range(2 * LAP)]
    return write(tmp_path / "painted", [np.vstack([image[:-50], strip]) for image in images])


def white() -> np.ndarray:
    return np.full((160, 240), 255, np.uint8)


def test_a_strip_that_never_moves_is_named_and_does_no_harm(painted: Path, truth: Path, tmp_path: Path, capsys) -> None:
    assert places(painted, tmp_path / "out", "--ground-truth", truth) == 0
    assert "never changes while the camera moves" in capsys.readouterr().out
    found = metrics(tmp_path / "out")
    assert 0.2 < found["static_ratio"] < 0.4
    assert found["places"]["true_positives"] >= LAP - 4
    assert found["places"]["tolerance_10"]["false_positives"] == 0


def test_a_mask_leaves_out_what_the_user_knows(painted: Path, truth: Path, tmp_path: Path) -> None:
    mask = white()
    mask[-60:] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    out = tmp_path / "out"
    assert places(painted, out, "--ground-truth", truth, "--mask", tmp_path / "mask.png") == 0
    assert metrics(out)["places"]["true_positives"] >= LAP - 4


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("missing", "expected an image, found none"),
        ("text", "expected an image, found a file that cannot be read"),
        ("small", "expected 240 x 160 pixels as the images have, found 240 x 100"),
        ("black", "found a black image"),
    ],
)
def test_a_mask_that_cannot_be_used_is_one_line(
    two_laps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, message: str
) -> None:
    mask = tmp_path / "mask.png"
    if content == "text":
        mask.write_text("no image")
    elif content != "missing":
        cv2.imwrite(str(mask), np.full((100 if content == "small" else 160, 240), 0 if content == "black" else 255))
    assert places(two_laps, tmp_path / "out", "--mask", mask) == 1
    printed = capsys.readouterr().err.strip()
    assert message in " ".join(printed.split())
    assert not (tmp_path / "out").exists()


def test_a_paradigm_of_whole_images_refuses_a_mask(two_laps: Path, tmp_path: Path, capsys) -> None:
    cv2.imwrite(str(tmp_path / "mask.png"), white())
    arguments = two_laps, tmp_path / "out", "--mask", tmp_path / "mask.png"
    assert places(*arguments, paradigm="pixel-sequences") == 2
    assert "compares whole images" in " ".join(capsys.readouterr().err.split())


def test_images_of_two_sizes_are_matched_in_the_size_of_the_first(
    two_laps: Path, truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = [cv2.imread(str(two_laps / f"{k}.png"), 0) for k in range(2 * LAP)]
    mixed = [cv2.resize(image, None, fx=0.75, fy=0.75) if k % 2 else image for k, image in enumerate(images)]
    out = tmp_path / "out"
    assert places(write(tmp_path / "mixed", mixed), out, "--ground-truth", truth) == 0
    assert f"{LAP} images were resized" in " ".join(capsys.readouterr().out.split())
    found = metrics(out)
    assert found["images_resized"] == LAP
    assert found["places"]["true_positives"] >= LAP - 4


def test_the_seed_reaches_the_recogniser(two_laps: Path, tmp_path: Path) -> None:
    scores = []
    for seed in (0, 5, 5):
        out = tmp_path / f"{len(scores)}"
        assert places(two_laps, out, "--seed", seed, paradigm="hierarchical-places") == 0
        scores.append((out / "matrix.npz").read_bytes())
    assert scores[1] == scores[2] != scores[0]


def test_remarks_about_the_truth_are_on_the_screen_and_in_the_metrics(
    two_laps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = np.eye(2 * LAP, k=LAP)
    stored[50, 2] = 1
    np.savez(tmp_path / "upper.npz", truth=stored)
    out = tmp_path / "out"
    assert places(two_laps, out, "--ground-truth", tmp_path / "upper.npz", paradigm="pixel-sequences") == 0
    remark = "upper.npz: the upper triangle is used with 30 entries; passed over 1 entry below the diagonal"
    assert remark in capsys.readouterr().err
    assert remark in metrics(out)["warnings"][0]
    assert metrics(out)["places"]["truth_rows"] == LAP


def test_a_truth_of_another_rate_is_matched_by_time(two_laps: Path, tmp_path: Path) -> None:
    turn = np.array([0.0, 2 * np.pi / LAP, 0.0, 0.0, 0.0, 5.0])  # an image's
    for name, steps in (("same.tum", np.arange(2 * LAP)), ("fast.tum", np.arange(0.0, 2 * LAP, 0.25))):
        write_tum(tmp_path / name, steps / 10, np.array([se3.exp(step * turn) for step in steps]))
        arguments = ["--fps", 10, "--ground-truth", tmp_path / name]
        assert places(two_laps, tmp_path / name[:4], *arguments, paradigm="pixel-sequences") == 0
    same, fast = metrics(tmp_path / "same")["places"], metrics(tmp_path / "fast")["places"]
    assert same["truth_rows"] == fast["truth_rows"] > 0
    assert same["average_precision"] == fast["average_precision"]
