"""`revisit locate`: images in whatever form, a table, CSV or JSON out, and one line for what cannot be."""

import csv
import json
import os
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.cli import app

LAP = 160
COLUMNS = (
    "image,localized,x_m,y_m,z_m,qx,qy,qz,qw,inliers,position_sigma_m,rotation_sigma_deg,matched_image,map_id,reason"
)


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr("sys.argv", ["revisit", *map(str, arguments)])
    with pytest.raises(SystemExit) as exit_:
        app.main()
    return int(exit_.value.code or 0)


@pytest.fixture(scope="module")
def photos(circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two images of the next lap under hostile names, and one of nothing."""
    folder = tmp_path_factory.mktemp("photos")
    for frame, name in ((LAP + 10, '[red]a, "b".png'), (LAP + 40, "10.png")):
        (folder / name).write_bytes((circle_drive / f"sequences/00/image_0/{frame:06d}.png").read_bytes())
    cv2.imwrite(str(folder / "2.png"), np.zeros((188, 620), np.uint8))
    return folder


def test_a_folder_gives_a_table_and_a_file(
    map_path: Path, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    out = tmp_path / "poses.csv"
    assert run(monkeypatch, "locate", map_path.parent, photos, "--out", out) == 0  # the folder of a run will do
    shown = capsys.readouterr().out
    assert "2 of 3 images found" in shown
    assert '[red]a, "b".png' in shown
    assert "not found: none of" in shown
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == COLUMNS.split(",")
    assert [(row["image"], row["localized"]) for row in rows] == [
        ("2.png", "false"),
        ("10.png", "true"),
        ('[red]a, "b".png', "true"),
    ]
    assert rows[0]["x_m"] == ""
    assert np.linalg.norm([float(rows[1][name]) for name in ("qx", "qy", "qz", "qw")]) == pytest.approx(1.0)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_file_name_with_invalid_characters_is_refused(
    map_path: Path, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    image = tmp_path / os.fsdecode(b"a\xff\n[b].png")
    image.write_bytes((photos / "10.png").read_bytes())
    for images in (image, tmp_path):
        assert run(monkeypatch, "locate", map_path, images) == 1
        said = capsys.readouterr().err
        assert "a? [b].png: expected a file name in Unicode" in said
        assert said.count("\n") == 1


def test_an_image_alone_gives_the_same_as_in_the_drive(
    map_path: Path,
    photos: Path,
    circle_drive: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def asked(images: Path) -> list[dict[str, object]]:
        assert run(monkeypatch, "locate", map_path, images, "--json") == 0
        return json.loads(capsys.readouterr().out)

    (alone,) = asked(photos / "10.png")
    drive = circle_drive.parent / "short"
    camera = drive / "sequences/00/image_0"
    camera.mkdir(parents=True, exist_ok=True)
    (camera / "000000.png").write_bytes((photos / "10.png").read_bytes())
    for name in ("calib.txt",):
        (drive / "sequences/00" / name).write_bytes((circle_drive / "sequences/00" / name).read_bytes())
    (within,) = asked(drive)
    assert alone["localized"]
    assert within["image"] == "000000.png"
    assert alone | {"image": ""} == within | {"image": ""}


def test_wrong_input_is_refused_in_one_line(
    map_path: Path, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((100, 200), np.uint8))
    (tmp_path / "broken.png").write_bytes(b"\x89PNG no image")
    for images, words in (
        (tmp_path / "small.png", "expected 620 x 188 pixels as in the map, found 200 x 100"),
        (tmp_path / "broken.png", "expected an image, found a file that cannot be read"),
        (tmp_path / "nowhere", "expected a recording, found nothing"),
        (tmp_path / "empty", "found neither"),
    ):
        assert run(monkeypatch, "locate", map_path, images) == 1
        said = capsys.readouterr().err
        assert said.startswith(f"revisit: {images}: ")
        assert words in said
        assert said.count("\n") == 1
    assert run(monkeypatch, "locate", tmp_path / "no.db", photos) == 1
    assert "expected a map database, found none" in capsys.readouterr().err


def test_a_table_that_cannot_be_written_is_found_before_the_work(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "locate", tmp_path / "no.db", photos, "--out", tmp_path / "nowhere" / "a.csv") == 1
    said = capsys.readouterr().err
    assert "nowhere/a.csv: expected a file to write in a folder that exists" in said
    assert "map database" not in said


def test_another_camera_is_refused(
    map_path: Path, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "image.png").write_bytes((photos / "10.png").read_bytes())
    (tmp_path / "camera.toml").write_text("fx=500\nfy=500\ncx=310\ncy=94\nfps=10\n")
    assert run(monkeypatch, "locate", map_path, tmp_path) == 1
    assert "expected the camera of the map" in capsys.readouterr().err
