"""What is counted in the source: kinds of models asked for by name, loops over time."""

import ast
from collections import Counter

from sources import SOURCE

LOOPS = ("scan", "fori_loop", "while_loop", "associative_scan")
ELSEWHERE = {
    "applications/video/boosting.py": "over the rounds of boosting",
    "core/loop.py": "the loop over time",
    "core/sums.py": "over blocks of particles",
    "costs/calibration.py": "repeats a product of matrices that is timed",
    "filters/alarm.py": "over all steps at once, in log2(t) rounds",
    "filters/landmark.py": "over the sightings of one step, and the landmarks of a map",
    "filters/parallel.py": "over all steps at once, in log2(t) rounds",
    "gaussian/association.py": "over the targets of one scan",
    "laws/association.py": "over the plots of one scan, and rounds of messages",
    "laws/near_plots.py": "over chunks of the plots of one scan",
    "laws/several_targets.py": "over the plots of one scan",
    "mcmc/compose.py": "repeats a kernel of a Markov chain, which has no time",
    "mcmc/discrete_gibbs.py": "over the coordinates of a position",
    "mcmc/sample.py": "over the moves of a Markov chain, which has no time",
    "montecarlo/annealing.py": "over temperatures",
    "montecarlo/chain.py": "over the steps of a Markov chain, which has no time",
    "montecarlo/tempering.py": "bisection",
    "resampling/allotment.py": "over the blocks of devices, which go round",
    "resampling/differentiable.py": "over the rounds of Sinkhorn's algorithm",
    "resampling/schemes.py": "over particles",
    "resampling/slotwise.py": "over the steps of a chain within one resampling",
    "smoothers/genealogy.py": "back from a step to a particle's ancestors",
    "smoothers/parents.py": "over trials of one draw",
}
"""Files with a loop that does not go backward, and over what it goes."""


TREES = {str(path.relative_to(SOURCE)): ast.parse(path.read_text()) for path in sorted(SOURCE.rglob("*.py"))}


def kinds_of_models():
    """Names of the classes that are models, or forms of models that filters make of them."""
    classes = [node for tree in TREES.values() for node in tree.body if isinstance(node, ast.ClassDef)]
    derived = {node.name for node in classes if any(isinstance(base, ast.Name) and base.id == "Model" for base in node.bases)}
    return derived | {node.name for node in classes if node.name.endswith("Model") and node.name != "Model"}


def asked_by_kind(tree, kinds):
    """Lines that ask whether something is of some kind."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("isinstance", "issubclass"):
            asked = node.args[1]
        elif isinstance(node, ast.Compare) and "type(" in ast.unparse(node.left):
            asked = node
        elif isinstance(node, ast.match_case):
            asked = node.pattern
        else:
            continue
        if {name.id for name in ast.walk(asked) if isinstance(name, ast.Name)} & kinds:
            yield node.lineno if hasattr(node, "lineno") else node.pattern.lineno


def test_nobody_outside_asks_for_the_kind_of_a_model():
    kinds = kinds_of_models()
    assert {"StateSpaceModel", "MixedLinearModel", "JumpMarkovModel", "SplitModel", "LocalModel"} <= kinds
    found = {name: list(asked_by_kind(tree, kinds)) for name, tree in TREES.items()}
    assert {name for name, lines in found.items() if lines and not name.startswith("models/")} == set()
    assert found["models/split.py"]
    for text in ("isinstance(m, (int, StateSpaceModel))", "type(m) is SplitModel", "match m:\n  case JumpMarkovModel():\n    pass"):
        assert list(asked_by_kind(ast.parse(text), kinds)), text


def loops(tree):
    """Lines with a loop of JAX's that does not go backward."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in LOOPS:
            if not any(word.arg == "reverse" and ast.unparse(word.value) == "True" for word in node.keywords):
                yield node.lineno


def test_there_is_one_loop_forward_over_time():
    found = {name for name, tree in TREES.items() if list(loops(tree))}
    assert found == set(ELSEWHERE)
    assert list(loops(ast.parse("jax.lax.scan(f, a, b)\nlax.scan(f, a, b, reverse=True)\nfori_loop(0, n, f, a)"))) == [1, 3]


FOREIGN = {
    "laws/law.py": "an object of another library that samples and has a density",
    "laws/spelled.py": "records among the names of a file",
    "tracing/reading.py": "whatever a user's function reads",
    "tracing/identity.py": "records of ours among them",
    "core/user_functions.py": "what wraps a user's function",
    "core/record.py": "named tuples",
    "mcmc/pseudo_marginal.py": "a density of the user's that can be estimated",
    "mcmc/sample.py": "a density of the user's that can be estimated",
    "mcmc/interface.py": "a position of the user's",
    "mcmc/reversible_jump.py": "a position of the user's",
    "studies/run.py": "what the operating system knows",
}
"""Files that ask what an object of somebody else's can do. What ours can do they say by attributes of their class."""


def asked_by_attribute(tree):
    """Lines that ask whether something has an attribute."""
    return [node.lineno for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "hasattr"]


def test_nobody_asks_ours_for_an_attribute():
    assert {name for name, tree in TREES.items() if asked_by_attribute(tree)} == set(FOREIGN)
    assert asked_by_attribute(ast.parse("x = 1\nhasattr(x, 'n')")) == [2]


COMMON = {"main": "of each command", "load": "of each application", "score": "of each application's runs"}
"""Names that many files give to a function because it is the same thing in each."""


def repeated(trees):
    """Names that three files or more give to a function of their own."""
    names = Counter(name for tree in trees for name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)})
    return {name for name, count in names.items() if count > 2} - {"_"}


def test_no_name_is_three_things():
    assert repeated(TREES.values()) == set(COMMON)
    assert repeated([ast.parse("def told(): pass")] * 3) == {"told"}
