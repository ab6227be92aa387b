import gymnasium
import numpy as np
import pytest
import torch

from bgn import domains
from bgn.errors import InputError
from bgn.planning.heuristics import qmdp
from bgn.policies.alpha_vectors import AlphaVectorPolicy, AlphaVectors
from bgn.simulation.policy import LanePolicy
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld
from tests.planning.models import domain_of, guess, random_model, tiger

#: Guess once a state is more than .85 likely: 1 - 4 (1 - p) > .4.
CAREFUL = AlphaVectors(vectors=np.array([[0.4, 0.4], [1.0, -3.0], [-3.0, 1.0]]), actions=np.array([0, 1, 2]))


def test_acting_follows_bayes():
    # Answers are right with .8: one gives .8, two that agree .64 / .68 = .94, two that differ .5 again.
    policy = AlphaVectorPolicy(CAREFUL, domain_of(guess()))
    policy.reset()
    assert [policy.act(2, None), policy.act(0, 0), policy.act(1, 0), policy.act(1, 0)] == [0, 0, 0, 0]
    assert policy.act(1, 0) == 2
    policy.reset()
    assert [policy.act(2, 3), policy.act(1, 0), policy.act(1, 0)] == [0, 0, 2]  # 3: no action yet


def test_a_hidden_first_action_is_taken_in():
    policy = AlphaVectorPolicy(CAREFUL, domain_of(guess()))
    policy.reset()
    assert [policy.act(0, 0), policy.act(0, 0)] == [0, 1]


@pytest.mark.parametrize("name", ["hallway", "rocksample-4-4", "top-plate"])
def test_lanes_act_as_one_lane_does(name):
    domain, lanes = domains.get(name), 40
    alpha = qmdp(domain.model)
    many = AlphaVectorPolicy(alpha, domain)
    assert isinstance(many, LanePolicy)
    single = [AlphaVectorPolicy(alpha, domain) for _ in range(lanes)]
    world, generator = TableWorld(domain, lanes), torch.Generator().manual_seed(0)
    world.reset(torch.rand(lanes, START_VARIATES, generator=generator))
    agreed = total = 0
    for _ in range(10):
        seen = zip(world.inputs.observation.tolist(), world.inputs.last_action.tolist(), strict=True)
        one_by_one = []
        for policy, (observation, action), fresh in zip(
            single, seen, world.inputs.fresh.tolist(), strict=True
        ):
            if fresh:
                policy.reset()
            one_by_one.append(policy.act(observation, action))
        chosen = many.act_in_lanes(world.inputs, generator)
        agreed, total = agreed + int((chosen == torch.tensor(one_by_one)).sum()), total + lanes
        openings = world.openings(torch.rand(lanes, START_VARIATES, generator=generator))
        world.step(chosen, torch.rand(lanes, STEP_VARIATES, generator=generator), openings)
    assert agreed >= 0.98 * total  # where two actions are as good, rounding decides


@pytest.mark.parametrize("environment_id", ["bgn/Hallway-v0", "bgn/TopPlate-v0"])
def test_it_acts_in_a_gymnasium_environment(environment_id):
    import bgn.environments  # noqa: F401  (registers them)

    env = gymnasium.make(environment_id)
    domain = env.unwrapped.domain  # type: ignore[attr-defined]
    policy = AlphaVectorPolicy(qmdp(domain.model), domain)
    earned = 0.0
    for seed in range(6):
        observation, info = env.reset(seed=seed)
        policy.reset()
        action, over = info["last_action"], False
        while not over:
            action = policy.act(observation, action)
            observation, reward, ended, truncated, _ = env.step(action)
            earned, over = earned + float(reward), ended or truncated
    env.close()
    assert earned >= 2


def test_the_best_of_many_vectors_is_found_piece_by_piece():
    generator = np.random.default_rng(0)
    domain = domain_of(random_model(0, n_states=6, n_actions=3))
    alpha = AlphaVectors(vectors=generator.normal(size=(3000, 6)), actions=generator.integers(3, size=3000))
    world = TableWorld(domain, 600)
    world.reset(torch.rand(600, START_VARIATES, generator=torch.Generator().manual_seed(0)))
    world.inputs.belief = torch.from_numpy(generator.dirichlet(np.ones(6), size=600)).float()
    chosen = AlphaVectorPolicy(alpha, domain).act_in_lanes(world.inputs, torch.Generator())
    values = world.inputs.belief.double().numpy() @ alpha.vectors.T
    assert (chosen.numpy() == alpha.actions[values.argmax(1)]).all()


def test_vectors_of_another_model_are_refused():
    domain = domain_of(tiger())
    with pytest.raises(InputError, match="policy is for 3 states, model has 2"):
        AlphaVectorPolicy(AlphaVectors(vectors=np.zeros((1, 3)), actions=np.array([0])), domain)
    with pytest.raises(InputError, match="takes action 7; model has 3"):
        AlphaVectorPolicy(AlphaVectors(vectors=np.zeros((1, 2)), actions=np.array([7])), domain)


@pytest.mark.parametrize(
    ("vectors", "actions", "message"),
    [
        (np.zeros((0, 2)), [], "one at least"),
        (np.zeros((2, 2)), [0], "1 actions for 2"),
        (np.full((1, 2), np.nan), [0], "finite"),
        (np.zeros((1, 2)), [-1], "action -1"),
    ],
)
def test_alpha_vectors_must_make_sense(vectors, actions, message):
    with pytest.raises(InputError, match=message):
        AlphaVectors(vectors=vectors, actions=np.array(actions, dtype=np.int64))
