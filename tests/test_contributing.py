"""The recipe of CONTRIBUTING.md, followed to the letter."""

import importlib.util
import inspect
import re
import sys
from pathlib import Path

from analysis.policy_study import policy_study
from models.planning import policy_files
from models.planning.finite_memory import infinite_value
from models.planning.latent import latent_problem
from models.planning.rollouts import simulate_policy
from models.protocol import PUBLISHED
from tests.models.planning.policy_cases import person

TEXT = (Path(__file__).resolve().parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8")
CHAPTER = TEXT.split("\n## Adding a policy\n")[1].split("\n## ")[0]
FILES = dict(re.findall(r"^```python ([\w/.]+)\n(.*?)^```$", CHAPTER, flags=re.MULTILINE | re.DOTALL))


def load(folder, name, monkeypatch):
    """Import a file of the recipe under the name it would have in the tree."""
    path = folder / Path(name).name
    path.write_text(FILES[name], encoding="utf-8")
    module = name.removesuffix(".py").replace("/", ".")
    spec = importlib.util.spec_from_file_location(module, path)
    made = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, module, made)
    spec.loader.exec_module(made)
    return made


def test_adding_a_policy(tmp_path, monkeypatch):
    kind, tests = FILES
    own = load(tmp_path, kind, monkeypatch)
    line = re.search(r'^```\n +"(\w+)": (\w+),\n```$', CHAPTER, flags=re.MULTILINE)
    monkeypatch.setitem(policy_files.KINDS, line[1], getattr(own, line[2]))
    found = [f for n, f in vars(load(tmp_path, tests, monkeypatch)).items() if n.startswith("test_")]
    assert len(found) >= 2
    for test in found:
        test(**({"tmp_path": tmp_path} if "tmp_path" in inspect.signature(test).parameters else {}))
    policy = own.Patient(PUBLISHED)
    assert "patient" in set(policy_study(person(), "HRH", more=[policy]).table["policy"])
    problem = latent_problem(person(), discount=0.9)
    simulated, exact = simulate_policy(policy, problem, runs=4000), infinite_value(policy, problem)
    assert abs(simulated.value - exact.value) < 5 * simulated.error + simulated.left
