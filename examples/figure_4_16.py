"""Figure 4.16 of the chapter: precision over recall of every paradigm, in one picture.

    python examples/figure_4_16.py                                    # two laps of a simulated street
    python examples/figure_4_16.py data/kitti --sequence 05 --ground-truth groundTruthKITTI05.mat --out runs/figure_4_16

Leaves figure_4_16.png. The left panel varies a threshold on the score of each paradigm by itself, the right panel on
the final score, after geometry and temporal model. Most paradigms share that end, so only the left panel tells them
apart. Random images are the control: they go through the same end. SOURCE is a drive in KITTI's layout, a folder of
images or a video; without --ground-truth its own poses decide what a revisit is. The results of each paradigm are in
its folder below OUT.
"""

import sys
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from street import arguments, street

from place_recognition.evaluation.precision_recall import PrecisionRecall
from place_recognition.paradigms.registry import PARADIGMS
from slam.apps.places import PlacesOptions, recognize_images, resolve_ground_truth
from slam.datasets.formats.registry import open_images
from slam.errors import RevisitError
from slam.report.place_recognition_figures import CONTROL_NAME, draw_precision_recall
from slam.report.style import INK, new_figure, save_png

PANELS = {"own": "from the score of each paradigm", "temporal": "after geometry and temporal model"}
Curves = dict[str, dict[str, PrecisionRecall | None]]  # by panel, then by paradigm


def main(given: list[str] | None = None) -> int:
    """Draw the figure. Returns an exit code."""
    parser = arguments(__doc__)
    parser.add_argument("source", type=Path, nargs="?", help="recording; the simulated street if none is given")
    parser.add_argument("--sequence", help="name of the sequence in SOURCE")
    parser.add_argument("--ground-truth", type=Path, help="matrix (.mat, .npz) or poses")
    parser.add_argument("--exclude", type=float, help="minimum age of a match, seconds: 40 in the papers")
    parser.add_argument("--paradigms", nargs="+", choices=PARADIGMS, default=list(PARADIGMS), metavar="NAME")
    chosen = parser.parse_args(given)
    source = chosen.source or street(chosen)
    options = PlacesOptions(source, "", chosen.out, chosen.sequence, chosen.ground_truth, exclude=chosen.exclude)
    try:
        curves = measure(replace(options, overwrite=True), chosen.paradigms)
    except RevisitError as error:
        print(error, file=sys.stderr)
        return 1
    figure = new_figure(12.0, 5.2)
    for ax, (panel, title) in zip(figure.subplots(1, 2), PANELS.items(), strict=True):
        draw_precision_recall(ax, curves[panel], "no paradigm reports a score of its own, or there is no truth")
        ax.set_title(title, color=INK, fontsize=11)
    save_png(figure, chosen.out / "figure_4_16.png")
    for name, curve in curves["temporal"].items():
        if curve is not None:
            print(f"{name:20} R@P100 {curve.recall_at_full_precision:.3f}, AP {curve.average_precision:.3f}")
    return 0


def measure(options: PlacesOptions, paradigms: list[str]) -> Curves:
    """Recognise the places of a recording by each paradigm, and return its curves and those of the control."""
    images, messages = open_images(options.recording), Console(stderr=True)
    truth = resolve_ground_truth(options, images)
    curves: dict[str, dict[str, PrecisionRecall]] = {panel: {} for panel in PANELS}
    for paradigm in paradigms:
        messages.print(paradigm)
        one = replace(options, paradigm=paradigm, out=options.out / paradigm)
        result = recognize_images(one, images, truth, messages).result
        for panel, drawn in curves.items():
            found = {paradigm: result.stages, CONTROL_NAME: result.control}
            drawn |= {name: stages.curves[panel] for name, stages in found.items() if stages and panel in stages.curves}
    # Every run has the same control; it comes last.
    return {panel: {name: drawn.get(name) for name in (*paradigms, CONTROL_NAME)} for panel, drawn in curves.items()}


if __name__ == "__main__":
    sys.exit(main())
