"""The folder is the block diagram: who may import whom, and where the heavy libraries live."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("odometry", "place_recognition", "slam")

# Of the product: 280 when it had pairs, one camera on wheels and towns; 32 for depth cameras (8), simulated rooms (10),
# one camera in any motion (4), two recordings against each other (4), learned features and descriptors (3), and parts
# of other programs (3).
MAX_FILES = 312
MAX_FILES_AT_THE_ROOT = 14  # of slam/
MAX_FILES_OF_A_FOLDER = 20
MAX_FILES_BELOW_THE_SYSTEM = 60  # what one must have read to understand slam/system.py to the bottom

# Each heavy library stands behind these paths alone.
QUARANTINE = {
    "gtsam": ("slam/pose_graph/",),
    "rerun": ("slam/viewer/",),
    "open3d": ("slam/mapping/", "slam/simulation/"),
    "pykitti": (),
    "rosbags": ("slam/datasets/formats/rosbag_file",),
    "yaml": ("slam/datasets/calibration_yaml",),
    "faiss": ("place_recognition/",),
    "onnxruntime": ("place_recognition/image_processing/onnx_network",),
    "distributed": ("slam/benchmark/executors",),
    "dask": ("slam/benchmark/executors",),
    "evo": (),
    "pycolmap": (),
}


def sources() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {imported(node.module, alias.name) for alias in node.names}
    return found


def imported(module: str, name: str) -> str:
    """What `from module import name` loads: a module of that name where there is one, else the module itself."""
    inner = ROOT.joinpath(*module.split("."), name)
    return f"{module}.{name}" if inner.with_suffix(".py").exists() or inner.is_dir() else module


def test_odometry_and_place_recognition_know_neither_each_other_nor_slam():
    for path in sources():
        package = path.relative_to(ROOT).parts[0]
        forbidden = set(PACKAGES) - {package} if package != "slam" else set()
        assert not {name.split(".")[0] for name in imports(path)} & forbidden, path


def test_only_the_command_line_the_demo_and_the_benchmark_know_the_run():
    for path in sources():
        if imports(path) & {"slam.pipeline.pipeline", "slam.cli.app"}:
            assert module_name(path) in {"slam.cli.run", "slam.apps.demo", "slam.benchmark.job"}, path


@pytest.mark.parametrize("library", QUARANTINE)
def test_each_heavy_library_stands_behind_one_place(library: str):
    for path in sources():
        inside = path.relative_to(ROOT).as_posix().startswith(QUARANTINE[library] or ("nowhere",))
        assert inside or library not in {name.split(".")[0] for name in imports(path)}, path


def test_modules_do_not_import_in_circles():
    known = {module_name(path) for path in sources()}
    graph = {module_name(path): imports(path) & known for path in sources()}
    visited: dict[str, bool] = {}

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert visited.get(module) is not False, f"import cycle: {' -> '.join((*trail, module))}"
        if module not in visited:
            visited[module] = False
            for other in graph[module] - {module}:
                visit(other, (*trail, module))
            visited[module] = True

    for module in graph:
        visit(module, ())


def folder_of(module: str) -> str:
    """The folder of a module; a module directly in a package stands for itself."""
    is_folder = ROOT.joinpath(*module.split(".")).is_dir()
    folder = module if is_folder else module.rpartition(".")[0]
    return module if folder in PACKAGES else folder


def folder_imports() -> dict[str, set[str]]:
    """For each folder those that its modules import, late imports within functions included."""
    known = {module_name(path) for path in sources()}
    graph: dict[str, set[str]] = {}
    for path in sources():
        if path.name == "__init__.py":
            continue  # the front of a package names what its folders offer
        folder = folder_of(module_name(path))
        others = {folder_of(name) for name in imports(path) & known}
        graph.setdefault(folder, set()).update(others - {folder})
    return graph


def circles(graph: dict[str, set[str]]) -> set[frozenset[str]]:
    """Sets of nodes each of which reaches all others of its set: the strongly connected components of several nodes."""

    def reachable(start: str) -> set[str]:
        found, waiting = set[str](), [start]
        while waiting:
            for other in graph.get(waiting.pop(), set()) - found:
                found.add(other)
                waiting.append(other)
        return found

    reached = {node: reachable(node) for node in graph}
    together = {node: frozenset(other for other in reached[node] if node in reached[other]) for node in graph}
    return {nodes for nodes in together.values() if len(nodes) > 1}


def test_benchmarks_and_the_product_do_not_import_tests():
    for path in (*sources(), *sorted((ROOT / "benchmarks").glob("*.py")), *sorted((ROOT / "examples").glob("*.py"))):
        assert not {name.split(".")[0] for name in imports(path)} & {"tests", "benchmarks"}, path


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == set()
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == {frozenset({"b", "c"})}
    assert circles({"a": {"b"}, "b": {"a"}, "c": {"d"}, "d": {"c", "a"}}) == {frozenset("ab"), frozenset("cd")}


def test_folders_do_not_import_in_circles():
    assert circles(folder_imports()) == set()


# Whoever opens a file from elsewhere must run nothing that it holds, nor crash where it is damaged.
UNSAFE = re.compile(r"eval|exec|compile|(yaml|np|numpy)\.load|(.*\.)?(loadmat|unsafe_load|full_load)")
UNSAFE_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "torch"}
# Submaps that the same process wrote into a folder of its own a moment ago.
OWN_FILES = {"slam/mapping/submaps.py": {"np.load"}}
# SciPy's reader may crash where a file is damaged: it runs in a process of its own, whose end is one error.
OWN_PROCESSES = {"place_recognition/evaluation/matlab_process.py": {"loadmat"}}


def unsafe_calls(text: str) -> set[str]:
    calls = {ast.unparse(node.func) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)}
    return {name for name in calls if UNSAFE.fullmatch(name)}


def test_nothing_that_is_read_can_run():
    for path in sources():
        text, name = path.read_text(), path.relative_to(ROOT).as_posix()
        assert not unsafe_calls(text) - OWN_FILES.get(name, set()) - OWN_PROCESSES.get(name, set()), name
        assert not {module.split(".")[0] for module in imports(path)} & UNSAFE_MODULES, name
        assert "allow_pickle=True" not in text, name
        assert "shell=True" not in text, name


def test_the_search_for_what_can_run_finds_it():
    assert unsafe_calls("np.load(p)") == {"np.load"}
    assert unsafe_calls("yaml.load(t)\neval(x)\nscipy.io.loadmat(p)") == {"yaml.load", "eval", "scipy.io.loadmat"}
    assert not unsafe_calls("re.compile(p)\nyaml.safe_load(t)\njson.load(f)")


HEAVY = {
    "cv2",
    "dask",
    "distributed",
    "faiss",
    "gtsam",
    "matplotlib",
    "numba",
    "numpy",
    "onnxruntime",
    "open3d",
    "rerun",
    "scipy",
}


@pytest.mark.parametrize(
    ("beginning", "needed"),
    [
        ("from slam.cli.app import app; app(['--help'], standalone_mode=False)", set()),
        ("from slam.cli.app import app; app(['run', '--help'], standalone_mode=False)", set()),
        # A run draws when its drive has ended, and needs nothing else that is heavy.
        (
            "import slam.cli.app, slam.pipeline.pipeline, slam.viewer.rerun_viewer",
            {"cv2", "gtsam", "numba", "numpy", "rerun", "scipy"},
        ),
    ],
    ids=["help", "help of a command", "start of a run"],
)
def test_a_start_loads_only_the_heavy_libraries_that_it_needs(beginning: str, needed: set[str]):
    code = f"{beginning}; import sys; print(*sorted({HEAVY} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, capture_output=True, text=True)
    assert set(done.stdout.splitlines()[-1].split()) == needed


def test_the_system_knows_no_files_no_sessions_and_no_viewer():
    known = {module_name(path): path for path in sources()}
    reached, waiting = set(), ["slam.system"]
    while waiting:
        module = waiting.pop()
        if module in known and module not in reached:
            reached.add(module)
            waiting += imports(known[module])
    folders = ("slam.map_database", "slam.io", "slam.viewer", "slam.pipeline")
    assert not [module for module in reached if module.startswith(folders)]
    assert len(reached) <= MAX_FILES_BELOW_THE_SYSTEM


def folder_sizes() -> dict[str, int]:
    folders = {path.parent for path in sources()}
    return {folder.relative_to(ROOT).as_posix(): len(list(folder.glob("*.py"))) for folder in folders}


def test_the_tree_stays_small():
    assert len(sources()) <= MAX_FILES
    assert folder_sizes()["slam"] <= MAX_FILES_AT_THE_ROOT
    assert {folder: count for folder, count in folder_sizes().items() if count > MAX_FILES_OF_A_FOLDER} == {}
