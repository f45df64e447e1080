"""The folders of `examples/` on the import path, one at a time: several have a `model.py`."""

import runpy
import sys
from contextlib import contextmanager
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


@contextmanager
def importable(name):
    """Let the files of an example be imported inside a `with` block, whatever modules of their names there are."""
    folder = EXAMPLES / name
    own = [path.stem for path in folder.glob("*.py")]
    others = {module: sys.modules.pop(module) for module in own if module in sys.modules}
    sys.path.insert(0, str(folder))
    try:
        yield folder
    finally:
        sys.path.remove(str(folder))
        for module in own:
            sys.modules.pop(module, None)
        sys.modules.update(others)


def loaded(name, program="run"):
    """Names of an example's program."""
    with importable(name) as folder:
        return runpy.run_path(str(folder / f"{program}.py"))
