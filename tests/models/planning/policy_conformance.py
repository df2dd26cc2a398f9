"""What every policy must do. A new kind of policy passes `conforms` and has a test that calls it."""

import json

import numpy as np
import pytest

from models.errors import InputError
from models.planning.policies import Policy
from models.planning.policy_files import policy_from_dict, policy_to_dict, read_policy, write_policy


def conforms(policy: Policy, world, modes, folder, *, seed=1, runs=20):
    """Follow a policy through runs of a latent-state model.

    Parameters
    ----------
    policy : Policy
    world : LatentStatePOMDP
        Responses are drawn from it.
    modes : sequence of int
        Mode of each event.
    folder : Path
        For its file.
    """
    assert isinstance(policy, Policy)
    assert policy.name
    again = policy_from_dict(json.loads(json.dumps(policy_to_dict(policy))))
    write_policy(policy, folder / "policy.json")
    stored = read_policy(folder / "policy.json")
    assert type(stored) is type(policy)
    assert stored.name == policy.name
    assert policy_to_dict(again) == policy_to_dict(policy) == policy_to_dict(stored)
    rng = np.random.default_rng(seed)
    histories = []
    for _ in range(runs):
        memory, copy, steps = policy.begin(modes[0]), stored.begin(modes[0]), []
        for k, mode in enumerate(modes):
            assert policy.mode_of(memory) == mode
            share = policy.probabilities(memory)
            assert share.shape == (len(policy.vocabulary.actions[mode]),)
            assert np.all(share >= 0)
            assert share.sum() == pytest.approx(1)
            assert np.array_equal(share, policy.probabilities(memory)), "asking twice changes the answer"
            assert np.array_equal(share, stored.probabilities(copy)), "the file acts otherwise"
            choice = policy.act(memory, rng)
            assert share[choice] > 0
            if policy.randomised:
                with pytest.raises(InputError, match="rng"):
                    policy.act(memory)
            else:
                assert policy.act(memory) == choice
            assert policy.vocabulary.actions[mode][choice] in policy.reason(memory)
            action = sum(len(m.actions) for m in world.protocol.modes[:mode]) + choice
            row = world.protocol.emission_index[action]
            seen = 0 if row < 0 else 1 + int(rng.integers(world.protocol.n_responses))
            refuses(policy, memory, mode)
            if k + 1 < len(modes):
                steps.append((mode, choice, seen, modes[k + 1]))
                memory = policy.observe(memory, choice, seen, modes[k + 1])
                copy = stored.observe(copy, choice, seen, modes[k + 1])
                assert np.array_equal(share, policy.probabilities(again_at(policy, steps[:-1], modes[0])))
        histories.append(steps)
    many(policy, histories, modes)


def again_at(policy, steps, first):
    memory = policy.begin(first)
    for _, choice, seen, after in steps:
        memory = policy.observe(memory, choice, seen, after)
    return memory


def refuses(policy, memory, mode):
    """Numbers out of range are refused by name."""
    words = policy.vocabulary
    with pytest.raises(InputError, match="mode"):
        policy.begin(len(words.modes))
    with pytest.raises(InputError, match="action in mode"):
        policy.observe(memory, len(words.actions[mode]), 0, mode)
    with pytest.raises(InputError, match="observation"):
        policy.observe(memory, 0, len(words.observations), mode)
    with pytest.raises(InputError, match="mode"):
        policy.observe(memory, 0, 0, -1)


def many(policy, histories, modes):
    """Runs worked on together do what each does alone."""
    memories = policy.begin_many(np.full(len(histories), modes[0]))
    for k in range(len(modes)):
        alone = [policy.probabilities(again_at(policy, h[:k], modes[0])) for h in histories]
        width = max(map(len, policy.vocabulary.actions))
        wanted = np.stack([np.pad(share, (0, width - len(share))) for share in alone])
        assert np.allclose(policy.probabilities_many(memories), wanted)
        if k + 1 < len(modes):
            _, choice, seen, after = (np.array(column) for column in zip(*(h[k] for h in histories), strict=True))
            memories = policy.observe_many(memories, choice, seen, after)
