"""Render a drive through a simulated town: the data that every example here runs on.

    python examples/1_simulate.py [--out runs/examples]

Leaves 1_simulate.png (the first stereo pair, and the path in plan view) and the drive itself, in KITTI's layout, so
that every other example and `revisit run` can read it.
"""

from street import arguments, street

from slam.datasets.formats.registry import open_dataset
from slam.report import style
from slam.report.style import new_figure, save_png, style_axes

given = arguments(__doc__).parse_args()

root = street(given)

drive = open_dataset(root)
print(f"{root}: {len(drive)} stereo pairs, {drive.timestamps[-1]:.0f} s, baseline {drive.camera.baseline} m")

first = drive[0]
positions = drive.ground_truth[:, :3, 3]  # of the left camera, in the frame of the first one, metres

figure = new_figure(9.0, 4.6)
panels = figure.subplot_mosaic([["left", "plan"], ["right", "plan"]], width_ratios=(5, 4))
for name in ("left", "right"):
    panels[name].imshow(getattr(first, name), cmap="gray", vmin=0, vmax=255)
    panels[name].set(title=f"{name} camera, frame 0", xticks=[], yticks=[])
style_axes(panels["plan"])
panels["plan"].plot(positions[:, 0], positions[:, 2], color=style.GROUND_TRUTH, ls="--")
panels["plan"].plot(0, 0, "o", color=style.CORRECTED, label="start")
panels["plan"].set(title="two laps, seen from above", xlabel="x [m]", ylabel="z [m]", aspect="equal")
panels["plan"].legend(frameon=False)
save_png(figure, given.out / "1_simulate.png")
