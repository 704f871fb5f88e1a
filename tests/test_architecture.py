"""The rules that keep the code readable and the layers apart; each rule is shown to fail on a source that breaks it."""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PRODUCT_PACKAGES = ("render", "precompute", "cloudfit")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())

MOST_FILE_LINES = 400
MOST_FUNCTION_LINES = 45

# Modules without behaviour of their own.
UNTESTED_MODULES = {"render/errors.py"}

# Pickle runs code from a file; torchvision has no build beside the CPU build of torch.
FORBIDDEN_IMPORTS = {"pickle", "cPickle", "dill", "joblib", "shelve", "marshal", "torchvision"}
FORBIDDEN_CALLS = {
    "torch.manual_seed": "seed a torch.Generator",
    "torch.seed": "seed a torch.Generator",
    "torch.random.manual_seed": "seed a torch.Generator",
    "random.seed": "pass a generator",
    "np.random.seed": "pass a generator",
    "numpy.random.seed": "pass a generator",
    "torch.load": "use safetensors, it runs no code",
    "torch.save": "use safetensors, it runs no code",
    "eval": "parse the text",
    "exec": "parse the text",
}

# Distributions whose import name is another.
IMPORT_NAMES = {"opencv-contrib-python-headless": "cv2"}
# Modules that are used where they are found and never asked for: bindings that pip cannot install.
OPTIONAL_MODULES = {"openvdb", "pyopenvdb"}


def product_files() -> list[Path]:
    return sorted(file for package in PRODUCT_PACKAGES for file in (ROOT / package).rglob("*.py"))


def all_files() -> list[Path]:
    others = [file for folder in ("benchmarks", "tests") for file in (ROOT / folder).rglob("*.py")]
    return product_files() + sorted(others)


def relative(file: Path) -> str:
    return file.relative_to(ROOT).as_posix()


def long_file(source: str) -> Iterator[str]:
    lines = len(source.splitlines())
    if lines > MOST_FILE_LINES:
        yield f"{lines} lines, at most {MOST_FILE_LINES}: a file is one idea"


def long_functions(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
            lines = (body[-1].end_lineno or 0) - body[0].lineno + 1
            if lines > MOST_FUNCTION_LINES:
                yield f"line {node.lineno}: {node.name} has {lines} lines, at most {MOST_FUNCTION_LINES}"


def imported_modules(source: str) -> Iterator[tuple[int, str]]:
    """Line and first name of each absolute import, `importlib.import_module` of a literal included."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name.partition(".")[0]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.lineno, node.module.partition(".")[0]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module") and node.args:
            argument = node.args[0]
            if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                yield node.lineno, argument.value.partition(".")[0]


def forbidden_imports(source: str) -> Iterator[str]:
    for line, name in imported_modules(source):
        if name in FORBIDDEN_IMPORTS:
            yield f"line {line}: imports {name}"


def forbidden_calls(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        if name in FORBIDDEN_CALLS:
            yield f"line {node.lineno}: calls {name}; {FORBIDDEN_CALLS[name]}"
        if any(word.arg == "allow_pickle" and ast.unparse(word.value) != "False" for word in node.keywords):
            yield f"line {node.lineno}: allows pickle"


def machine_paths(source: str) -> Iterator[str]:
    """Absolute paths of somebody's machine in string literals."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            for path in re.findall(r"(?:^|[\s'\"`])(/(?:home|root|work|tmp|Users)/\S*)", node.value):
                yield f"line {node.lineno}: the path {path} exists on one machine only"


SOURCE_RULES: dict[str, tuple[Callable[[str], Iterator[str]], Callable[[], list[Path]], str]] = {
    "files are short": (long_file, all_files, "x = 1\n" * (MOST_FILE_LINES + 1)),
    "functions are short": (
        long_functions,
        product_files,
        "def f() -> None:\n    '''Doc.'''\n" + "    x = 1\n" * (MOST_FUNCTION_LINES + 1),
    ),
    "nothing is unpickled": (forbidden_imports, all_files, "def f():\n    from pickle import loads\n"),
    "torchvision is not needed": (forbidden_imports, all_files, "import torchvision.transforms as t\n"),
    "no global seed": (forbidden_calls, product_files, "import torch\ntorch.manual_seed(1)\n"),
    "no code from files": (forbidden_calls, product_files, "import torch\ntable = torch.load('x.pt')\n"),
    "no pickled arrays": (forbidden_calls, all_files, "import numpy as np\nnp.load('x', allow_pickle=True)\n"),
    "no path of one machine": (machine_paths, all_files, "DATA = '/home/me/data.npz'\n"),
}

ALLOWED = {
    long_file: "x = 1\n" * MOST_FILE_LINES,
    long_functions: "def f() -> None:\n    '''" + "Doc.\n" * 90 + "    '''\n" + "    x = 1\n" * MOST_FUNCTION_LINES,
    forbidden_imports: "import torch\nfrom . import pickle\nunpickle = 'pickle'\n",
    forbidden_calls: "g = torch.Generator()\ng.manual_seed(1)\nmodel.eval()\nnp.load('x', allow_pickle=False)\n",
    machine_paths: "DATA = 'photos/x.jpg'\nHALF = 'and/or'\nURL = 'https://example.org/opt/x'\n",
}


@pytest.mark.parametrize("rule", SOURCE_RULES)
def test_every_file_keeps_the_rule(rule: str) -> None:
    check, files, _ = SOURCE_RULES[rule]
    this_file = Path(__file__).resolve()  # quotes what it forbids
    broken = [
        f"{relative(file)}: {fault}" for file in files() if file != this_file for fault in check(file.read_text())
    ]
    assert not broken, "\n".join(broken)


@pytest.mark.parametrize("rule", SOURCE_RULES)
def test_the_rule_is_noticed_when_broken(rule: str) -> None:
    check, _, bad_source = SOURCE_RULES[rule]
    assert len(list(check(bad_source))) == 1
    assert not list(check(ALLOWED[check]))


def expected_test_file(module: str) -> str:
    """Where the tests of a module live: the same place below tests/unit, a package's own beside its folder."""
    path = Path(module)
    if path.name == "__init__.py":
        path = path.parent.with_suffix(".py")
    return (Path("tests/unit") / path.parent / f"test_{path.name}").as_posix()


def modules_without_tests(modules: list[str], test_files: set[str]) -> list[str]:
    return [
        module
        for module in modules
        if not module.endswith("__init__.py")
        and module not in UNTESTED_MODULES
        and expected_test_file(module) not in test_files
    ]


def orphaned_tests(modules: list[str], test_files: set[str]) -> list[str]:
    expected = {expected_test_file(module) for module in modules}
    return sorted(file for file in test_files - expected if Path(file).name.startswith("test_"))


def test_the_tests_mirror_the_packages() -> None:
    modules = [relative(file) for file in product_files()]
    test_files = {relative(file) for file in (ROOT / "tests" / "unit").rglob("*.py")}
    missing, orphaned = modules_without_tests(modules, test_files), orphaned_tests(modules, test_files)
    assert not missing, "no test file: " + ", ".join(missing)
    assert not orphaned, "tests of no module: " + ", ".join(orphaned)
    assert set(modules) >= UNTESTED_MODULES


def test_a_missing_or_orphaned_test_file_is_noticed() -> None:
    modules = ["render/colour.py", "cloudfit/__init__.py", "cloudfit/optimisers/base.py"]
    test_files = {"tests/unit/render/test_colour.py", "tests/unit/cloudfit/optimisers/test_base.py"}
    assert not modules_without_tests(modules, test_files)
    assert not orphaned_tests(modules, test_files)
    assert modules_without_tests([*modules, "render/camera.py"], test_files) == ["render/camera.py"]
    orphan = "tests/unit/render/test_removed.py"
    assert orphaned_tests(modules, {*test_files, orphan}) == [orphan]


def run_import_linter(folder: Path) -> subprocess.CompletedProcess[str]:
    command = (
        "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True, no_logo=True))"
    )
    return subprocess.run([sys.executable, "-c", command], cwd=folder, capture_output=True, text=True, check=False)


def test_imports_go_one_way() -> None:
    run = run_import_linter(ROOT)
    assert run.returncode == 0, run.stdout + run.stderr


def test_an_import_against_the_layers_is_noticed(tmp_path: Path) -> None:
    contract = (ROOT / "pyproject.toml").read_text().partition("[tool.importlinter]")[2].partition("[tool.pytest")[0]
    (tmp_path / "pyproject.toml").write_text("[tool.importlinter]" + contract)
    for package in PRODUCT_PACKAGES:
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("")
    (tmp_path / "precompute" / "tables.py").write_text("import render\n")
    assert run_import_linter(tmp_path).returncode == 0
    (tmp_path / "render" / "cheat.py").write_text("import precompute.tables\n")
    run = run_import_linter(tmp_path)
    assert run.returncode != 0
    assert "render is not allowed to import precompute" in run.stdout


def declared_imports() -> dict[str, str]:
    """Import name of each dependency, to the name of its distribution."""
    extras = PROJECT["project"]["optional-dependencies"]
    names = [
        re.split(r"[<>=!~\[; ]", line)[0]
        for line in PROJECT["project"]["dependencies"] + extras["fast"] + extras["shafts"]
    ]
    return {IMPORT_NAMES.get(name, name): name for name in names}


def foreign_modules(sources: list[str]) -> set[str]:
    own = {*PRODUCT_PACKAGES, *sys.stdlib_module_names}
    return {name for source in sources for _, name in imported_modules(source)} - own


def test_every_dependency_is_used_and_every_import_declared() -> None:
    used = foreign_modules([file.read_text() for file in product_files()])
    declared = declared_imports()
    unused = {distribution for module, distribution in declared.items() if module not in used}
    assert not unused, f"dependencies that nothing imports: {sorted(unused)}"
    undeclared = used - set(declared) - OPTIONAL_MODULES
    assert not undeclared, f"imports that pyproject.toml does not ask for: {sorted(undeclared)}"


def test_numba_is_asked_for_by_fused_loops_alone_and_these_only_within_functions() -> None:
    for file in product_files():
        fused = file.name.startswith("fused_")
        names = foreign_modules([file.read_text()])
        assert ("numba" in names) is fused, relative(file)
        if not fused:
            assert not eager_fused_imports(file.read_text()), relative(file)
    assert eager_fused_imports("from render.fused_trilinear import look_up_trilinear\n")
    assert not eager_fused_imports("def f() -> None:\n    from render.fused_trilinear import look_up_trilinear\n")


def eager_fused_imports(source: str) -> list[str]:
    """Fused modules that are imported as soon as the module itself is."""
    modules = [node.module or "" for node in ast.parse(source).body if isinstance(node, ast.ImportFrom)]
    return [name for name in modules if name.rpartition(".")[2].startswith("fused_")]


def test_imports_are_found_wherever_they_stand() -> None:
    source = "import torch.nn\nfrom scipy import sparse\ndef f():\n    import importlib\n    importlib.import_module('cv2.x')\n"
    assert foreign_modules([source, "from render.units import LENGTH\nimport json\n"]) == {"torch", "scipy", "cv2"}


def distribution_name(requirement: str) -> str:
    return re.split(r"[<>=!~\[; ]", requirement)[0].lower().replace("_", "-")


def test_constraints_pin_every_dependency_exactly() -> None:
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and line[0] != "#"]
    assert not [line for line in lines if not re.fullmatch(r"[\w.-]+==[0-9][0-9a-z.]*", line)], "no paths, no builds"
    pinned = {distribution_name(line) for line in lines}
    extras = PROJECT["project"]["optional-dependencies"]
    wanted = [*PROJECT["project"]["dependencies"], *extras["test"], *extras["fast"], *extras["shafts"]]
    assert not [line for line in wanted if distribution_name(line) not in pinned]
