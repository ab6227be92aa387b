"""The fixed evaluation of final policies: every seed's episodes side by side, sampled or greedy."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bgn.agents.a2c import sample_actions
from bgn.agents.hyperparameters import Hyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.domains.domain import Domain
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld
from bgn.training.random_streams import Purpose, RandomStreams

#: Steps between looks at whether every episode is over; looking makes the device wait.
PATIENCE = 10
#: Episodes of one seed simulated at once; more would leave the processor's cache.
BATCH = 250


def evaluate(
    networks: AgentNetworks, domain: Domain, settings: Hyperparameters, episodes: int, *, greedy: bool
) -> list[dict[str, float]]:
    """Run ``episodes`` whole episodes of each seed's policy.

    Returns
    -------
    One dictionary a seed: ``return`` (mean, discounted as the domain reports it), ``return_se`` and
    ``return_sd`` (over episodes), ``success``, ``success_se``, ``length`` (mean counted steps).
    """
    seeds = networks.parameters.seeds
    purpose = Purpose.GREEDY_EVALUATION if greedy else Purpose.SAMPLED_EVALUATION
    streams = RandomStreams(seeds, purpose, networks.parameters.device)
    batches, done = [], 0
    while done < episodes:
        lanes = min(BATCH, episodes - done)
        first_block = done * (domain.episode_limit + 1)
        batches.append(_batch(networks, domain, settings, lanes, streams, first_block, greedy))
        done += lanes
    returns, totals, lengths = (torch.cat(part, 1).double().cpu() for part in zip(*batches, strict=True))
    return [_summary(*row) for row in zip(returns, totals, lengths, strict=True)]


@torch.no_grad()
def _batch(
    networks: AgentNetworks,
    domain: Domain,
    settings: Hyperparameters,
    lanes: int,
    streams: RandomStreams,
    first_block: int,
    greedy: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """Discounted returns, plain sums and lengths of one episode in each lane: three times (S, lanes)."""
    device, S = networks.parameters.device, len(networks.parameters.seeds)
    world = TableWorld(
        domain,
        S * lanes,
        device=device,
        hidden_first_action=settings.hidden_first_action,
        track_beliefs=networks.actor.kind == "belief",
    )
    world.reset(streams.block(first_block, 1, lanes, START_VARIATES)[0])
    networks.prepare()
    hidden = torch.zeros(S, lanes, networks.hidden_width, device=device)
    alive = torch.ones(S, lanes, device=device)
    returns, totals, lengths = torch.zeros_like(alive), torch.zeros_like(alive), torch.zeros_like(alive)
    for t in range(domain.episode_limit):
        hidden, logits = networks.act(world.inputs, hidden)
        variates = streams.block(first_block + 1 + t, 1, lanes, 1 + STEP_VARIATES)[0]
        if greedy:
            action = logits.argmax(-1)
        else:
            action = sample_actions(logits.softmax(-1), variates[:, 0].view(S, lanes))
        outcome = world.step(action.flatten(), variates[:, 1:], world.inputs)
        earned = outcome.reward.view(S, lanes) * alive
        returns.add_(earned, alpha=domain.report_discount**t)
        totals += earned
        lengths += alive
        alive *= ~(outcome.ended | outcome.truncated).view(S, lanes)
        if t % PATIENCE == PATIENCE - 1 and not alive.any():
            break
    return returns, totals, lengths


def _summary(returns: Tensor, totals: Tensor, lengths: Tensor) -> dict[str, float]:
    n = len(returns)
    success = (totals > 0).double().mean().item()
    return {
        "return": returns.mean().item(),
        "return_se": returns.std(correction=1).item() / math.sqrt(n) if n > 1 else math.nan,
        "return_sd": returns.std(correction=0).item(),
        "success": success,
        "success_se": math.sqrt(success * (1 - success) / n),
        "length": lengths.mean().item(),
    }
