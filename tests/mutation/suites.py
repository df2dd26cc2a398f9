"""Which tests are meant to pin which kernels."""

from __future__ import annotations

KERNELS = "tests/models/test_kernels_by_hand.py"
EM = "tests/models/test_em_by_hand.py"
DENSITY = "tests/models/test_density_by_hand.py"
QUADRATURE = "tests/models/test_quadrature_by_hand.py"
EXACT = "tests/models/test_exact_by_hand.py"
PLANNING = "tests/models/planning"
TREE = f"{PLANNING}/test_belief_tree_by_hand.py"
SAWTOOTH = f"{PLANNING}/test_sawtooth_by_hand.py"
BACKUPS = f"{PLANNING}/test_node_backups_by_hand.py"
VECTORS = f"{PLANNING}/test_vectors_by_hand.py"
INFORMED = f"{PLANNING}/test_informed_bounds_by_hand.py"
STEPS = f"{PLANNING}/test_steps_by_hand.py"

SUITES: dict[str, list[str]] = {
    "models/forward_backward.py": [KERNELS],
    "models/em_kernel.py": [EM, KERNELS],
    "models/hmm_density.py": [DENSITY, "tests/models/test_hmm_density.py"],
    "models/draw_kernels.py": [DENSITY, KERNELS],
    "models/planning/fast_informed_bound.py": [INFORMED],
    "models/planning/vectors.py": [VECTORS, BACKUPS, TREE, f"{PLANNING}/test_vectors.py"],
    "models/planning/step_kernel.py": [STEPS, BACKUPS, VECTORS, TREE, f"{PLANNING}/test_step_kernel.py"],
    "models/planning/belief_tree.py": [TREE, SAWTOOTH, BACKUPS],
    "models/planning/node_backups.py": [BACKUPS, SAWTOOTH, TREE],
    "models/glmm_kernel.py": [QUADRATURE, "tests/models/test_glmm_kernel.py"],
    "models/glmm_nodes.py": [QUADRATURE, "tests/models/test_glmm_nodes.py"],
    "models/glmm_exact.py": [EXACT],
}
"""Tests of every file, relative to the checkout: small ones, as kernels are interpreted."""
