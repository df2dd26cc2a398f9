"""The notebooks: scripts in ``notebooks/`` turned into executed ``.ipynb`` files that hardly differ between runs.

``python -m analysis.notebooks [--fast] [--check] [NAME ...]``. A notebook is written as a py:percent script; its
``.ipynb`` is made from the script, executed from the checkout's root by this interpreter, and stored with its
output. Its first code cell is tagged ``parameters`` and holds ``FAST = False``; a fast run overrides that in a cell
of its own behind it and stores nothing. Any error, warning or other output to stderr fails the run.

The packages that read and run notebooks are imported where they are used: what they import builds grammars, which
takes longer than everything else that a process needs to list the scripts.
"""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jupyter_client.kernelspec import KernelSpec
from jupyter_client.manager import AsyncKernelManager

from models.errors import InputError, located
from models.model_files import write_text

if TYPE_CHECKING:
    from nbclient import NotebookClient
    from nbformat import NotebookNode

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "notebooks"
PARAMETERS = "parameters"
"""Tag of the first code cell."""

FAST = {"FAST": True}
"""What a fast run overrides."""

ABSENT = "REAL DATA NOT AVAILABLE"
"""Printed by cells that could not have their data; a run in which one did is never stored."""

CELL_SECONDS = 600

_METADATA: dict[str, Any] = {
    "jupytext": {"formats": "ipynb,py:percent"},
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"file_extension": ".py", "mimetype": "text/x-python", "name": "python",
                      "pygments_lexer": "ipython3"},
}  # fmt: skip


class NotebookError(InputError):
    """A notebook that did not run cleanly, is not stored, or differs from its script."""


# -- scripts ---------------------------------------------------------------------------------------
def scripts(names: Sequence[str] = (), folder: Path = FOLDER) -> list[Path]:
    """Scripts in order, all or those whose name begins with one of `names` (``01`` will do).

    Raises
    ------
    InputError
        If a name begins no script.
    """
    known = sorted(folder.glob("[0-9][0-9]_*.py"))
    for name in names:
        if not any(path.stem.startswith(Path(name).stem) for path in known):
            raise located("notebook", name, f"one of {', '.join(path.stem for path in known)}")
    return [p for p in known if not names or any(p.stem.startswith(Path(n).stem) for n in names)]


def read_script(path: Path) -> NotebookNode:
    """The notebook of a script, without output, with metadata that say nothing about the machine.

    Cells are identified by their text (and how often it occurred before), so that inserting one leaves the ids of
    all others alone.

    Raises
    ------
    NotebookError
        If the first code cell is not tagged ``parameters``.
    """
    import jupytext
    import nbformat

    notebook = nbformat.from_dict(jupytext.read(path, fmt="py:percent"))
    notebook.metadata = nbformat.from_dict(_METADATA)
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    seen: dict[str, int] = {}
    for cell in notebook.cells:
        before = seen[cell.source] = seen.get(cell.source, -1) + 1
        cell.id = hashlib.sha256(f"{path.stem}\n{before}\n{cell.source}".encode()).hexdigest()[:12]
        cell.metadata = nbformat.from_dict({k: v for k, v in cell.metadata.items() if k == "tags"})
    if PARAMETERS not in next((tags_of(c) for c in notebook.cells if c.cell_type == "code"), []):
        raise NotebookError(f"{path.name}: its first code cell is not tagged {PARAMETERS!r}")
    return notebook


def tags_of(cell: NotebookNode) -> list[str]:
    """Tags of a cell."""
    return list(cell.metadata.get("tags", []))


def with_parameters(notebook: NotebookNode, values: Mapping[str, object]) -> NotebookNode:
    """Copy with a cell behind the parameters cell that assigns `values` anew."""
    import nbformat

    copy = nbformat.from_dict(notebook)
    place = next(i for i, c in enumerate(copy.cells) if PARAMETERS in tags_of(c))
    text = "\n".join(f"{name} = {value!r}" for name, value in values.items())
    cell = nbformat.v4.new_code_cell(text, id="injected", metadata={"tags": ["injected-parameters"]})
    copy.cells.insert(place + 1, cell)
    return copy


# -- execution -------------------------------------------------------------------------------------
class _OwnKernel(AsyncKernelManager):
    """A kernel of the interpreter that runs this: no kernel specification has to be installed."""

    @property
    def kernel_spec(self) -> KernelSpec:
        argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
        return KernelSpec(argv=argv, display_name="Python 3", language="python")


def execute(notebook: NotebookNode, name: str, root: Path = ROOT) -> NotebookNode:
    """Run every cell with `root` as working folder.

    Raises
    ------
    NotebookError
        Naming notebook and cell, on an error, on anything written to stderr (where warnings go), or when a cell
        takes longer than `CELL_SECONDS`.
    """
    import nbformat
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

    # Profiles and start-up files of whoever runs this must not change what a notebook does.
    with tempfile.TemporaryDirectory() as own:
        manager = _OwnKernel(connection_file=str(Path(own) / "kernel.json"))
        if os.name == "posix":  # sockets in a folder of our own: no ports, nobody else can listen
            manager.transport, manager.ip = "ipc", str(Path(own) / "kernel")
        client = NotebookClient(
            notebook, km=manager, timeout=CELL_SECONDS, record_timing=False,
            resources={"metadata": {"path": str(root)}},
        )  # fmt: skip
        environment = {
            **os.environ, "IPYTHONDIR": own, "PYDEVD_DISABLE_FILE_VALIDATION": "1", "MPLBACKEND": "agg",
            "COLUMNS": "100",
        }  # fmt: skip
        try:
            asyncio.run(_execute(client, manager, environment))
        except CellExecutionError as error:
            cell = next(c for c in notebook.cells if c.cell_type == "code" and _failed(c))
            raise NotebookError(f"{_place(notebook, cell, name)}: {error.ename}: {error.evalue}") from None
        except CellTimeoutError:
            running = [c for c in notebook.cells if c.cell_type == "code" and c.execution_count is None]
            place = _place(notebook, running[0], name) if running else name
            raise NotebookError(f"{place}: took longer than {CELL_SECONDS} s") from None
        except DeadKernelError as error:
            raise NotebookError(f"{name}: the kernel died: {error}") from None
    notebook.metadata = nbformat.from_dict(_METADATA)  # the kernel adds its version
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", []):
            if output.output_type == "stream" and output.name == "stderr":
                place = _place(notebook, cell, name)
                raise NotebookError(f"{place}: wrote to stderr, where warnings go: {output.text.strip()}")
        if cell.cell_type == "code":
            cell.outputs = _joined(cell.outputs)
    return notebook


def _joined(outputs: Sequence[NotebookNode]) -> list[NotebookNode]:
    """Prints that follow each other as one: into how many pieces they fall depends on how busy the machine is."""
    out: list[NotebookNode] = []
    for output in outputs:
        if out and output.output_type == out[-1].output_type == "stream" and output.name == out[-1].name:
            out[-1].text += output.text
        else:
            out.append(output)
    return out


async def _execute(client: NotebookClient, manager: AsyncKernelManager, environment: Mapping[str, str]) -> None:
    try:
        await client.async_execute(env=environment)
    finally:
        if client.kc is not None:
            client.kc.stop_channels()
        if manager.has_kernel:
            await manager.shutdown_kernel(now=True)


def _failed(cell: NotebookNode) -> bool:
    return any(output.output_type == "error" for output in cell.outputs)


def _place(notebook: NotebookNode, cell: NotebookNode, name: str) -> str:
    """Notebook and cell, by number and first line."""
    code = [c for c in notebook.cells if c.cell_type == "code"]
    number = next(i for i, c in enumerate(code, start=1) if c is cell)
    first = cell.source.strip().split("\n", 1)[0]
    return f"{name}, code cell {number} ({first!r})"


def run(path: Path, *, fast: bool = False, root: Path = ROOT) -> None:
    """Execute one notebook and, unless `fast`, store it beside its script.

    Raises
    ------
    NotebookError
        As `execute`; also, after storing nothing, if data that the notebook shows could not be had.
    """
    import nbformat

    notebook = read_script(path)
    name = path.with_suffix(".ipynb").name
    done = execute(with_parameters(notebook, FAST) if fast else notebook, name, root)
    text = nbformat.writes(done)
    nbformat.validate(done)
    if fast:
        return
    if any(ABSENT in line for line in _printed(done)):
        raise NotebookError(
            f"{name}: ran without an error but is not stored: data it shows could not be had, and what is stored "
            "would be lost. Set PROSOCIAL_DATA to the folder that has them"
        )
    write_text(path.with_suffix(".ipynb"), text.rstrip("\n") + "\n")


def _printed(notebook: NotebookNode) -> list[str]:
    outputs = [o for c in notebook.cells for o in c.get("outputs", []) if o.output_type == "stream"]
    return [line for output in outputs for line in output.text.split("\n")]


# -- stored notebooks ------------------------------------------------------------------------------
def check(path: Path) -> None:
    """Compare the stored notebook with its script, and see that it has been executed from top to bottom.

    Raises
    ------
    NotebookError
        On the first difference, naming the cell.
    """
    import nbformat

    stored_path = path.with_suffix(".ipynb")
    name, again = stored_path.name, "run `make notebooks`"
    if not stored_path.exists():
        raise NotebookError(f"{name}: is not there; {again}")
    stored = nbformat.read(stored_path, as_version=4)
    script = read_script(path)
    for i, (ours, theirs) in enumerate(zip(script.cells, stored.cells, strict=False), start=1):
        if (ours.cell_type, ours.source, ours.id) != (theirs.cell_type, theirs.source, theirs.id):
            raise NotebookError(f"{name}, cell {i}: differs from {path.name}; {again}")
    if len(script.cells) != len(stored.cells):
        raise NotebookError(
            f"{name}: found {len(stored.cells)} cells, wanted {len(script.cells)} as {path.name}; {again}"
        )
    code = [c for c in stored.cells if c.cell_type == "code"]
    for i, cell in enumerate(code, start=1):
        if cell.execution_count != i:
            raise NotebookError(f"{name}, code cell {i}: found no output of a run from top to bottom; {again}")
    if not any(cell.outputs for cell in code):
        raise NotebookError(f"{name}: has no output; {again}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run or check notebooks; every one is tried, and 1 is returned if any fails."""
    parser = argparse.ArgumentParser(prog="python -m analysis.notebooks", description=__doc__.split("\n", 1)[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="beginnings of names, such as 01; all by default")
    parser.add_argument("--fast", action="store_true", help="few draws; store nothing")
    parser.add_argument("--check", action="store_true", help="run nothing: is what is stored up to date?")
    options = parser.parse_args(arguments)
    failed = 0
    try:
        chosen = scripts(options.names)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    for path in chosen:
        started = time.perf_counter()
        try:
            if options.check:
                check(path)
            else:
                run(path, fast=options.fast)
        except InputError as error:
            failed = 1
            print(f"FAILED {error}", file=sys.stderr, flush=True)
        else:
            print(f"{path.stem}: good, {time.perf_counter() - started:.1f} s", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
