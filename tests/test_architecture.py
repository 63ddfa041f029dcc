"""The folder is the block diagram: who may import whom, and where the heavy libraries live."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("odometry", "place_recognition", "slam")

# Each heavy library stands behind these paths alone.
QUARANTINE = {
    "gtsam": ("slam/pose_graph",),
    "rerun": ("slam/viewer/",),
    "open3d": ("slam/mapping/", "slam/simulation/"),
    "pykitti": ("slam/datasets/kitti",),
    "rosbags": ("slam/datasets/bag_file",),
    "yaml": ("slam/datasets/euroc",),
    "faiss": ("place_recognition/",),
    "onnxruntime": ("place_recognition/image_processing/onnx_descriptor",),
    "evo": (),
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


def test_only_the_command_line_and_the_demo_know_the_run():
    for path in sources():
        if imports(path) & {"slam.run", "slam.cli"}:
            assert module_name(path) in {"slam.cli", "slam.demo"}, path


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


def test_help_loads_no_heavy_library():
    code = (
        "import sys, slam.cli; "
        "heavy = {'gtsam','cv2','open3d','rerun','faiss','numba','matplotlib','scipy'} & set(sys.modules); "
        "sys.exit(f'loaded: {heavy}' if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
