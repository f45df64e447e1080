"""A notebook beside each example, made of its page and its program; by night (MOTES_NIGHTLY) with what it prints."""

import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

EXAMPLES = Path(__file__).parents[1] / "examples"
KERNEL = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
NIGHT = bool(os.environ.get("MOTES_NIGHTLY"))
LONGEST = 3600
"""Seconds that an example may take."""
SHOW = """from pathlib import Path
from IPython.display import Image, display
for picture in sorted(Path("out").glob("*.png")):
    display(Image(picture))"""


def notebook(folder):
    """Return the notebook of an example: its page, its program up to `main`, that called, and the pictures that it wrote."""
    before, _, _ = (folder / "run.py").read_text().partition('\n\nif __name__ == "__main__":')
    functions, _, main = before.partition("\n\ndef main(")
    call = 'import sys\n__file__ = "run.py"\nsys.argv = [__file__]  # words of the command line\nmain()'
    cells = [new_markdown_cell((folder / "README.md").read_text()), new_code_cell(functions.strip()), new_code_cell(f"def main({main}")]
    return new_notebook(cells=[*cells, new_code_cell(call), new_code_cell(SHOW)], metadata=KERNEL)


def write(names=()):
    """Write the notebooks of all examples, or of some, and by night run them."""
    for program in sorted(EXAMPLES.glob("*/run.py")):
        folder = program.parent
        if names and folder.name not in names:
            continue
        made = notebook(folder)
        if NIGHT:
            NotebookClient(made, timeout=LONGEST, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
        nbformat.write(made, folder / f"{folder.name}.ipynb")


if __name__ == "__main__":
    write(sys.argv[1:])
