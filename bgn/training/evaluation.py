"""The fixed evaluation of a final policy: many episodes side by side, sampled or greedy."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from bgn.agents.a2c import sample_actions
from bgn.agents.hyperparameters import CommonHyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.domains.domain import Domain
from bgn.simulation.table_world import START_VARIATES, STEP_VARIATES, TableWorld
from bgn.training.random_streams import Purpose, RandomStreams

#: Steps between checks of which episodes are over; a check waits for the device.
CHECK_INTERVAL = 5
#: Episodes simulated at once.
BATCH = 500


def evaluate(
    networks: AgentNetworks, domain: Domain, settings: CommonHyperparameters, episodes: int, *, greedy: bool
) -> dict[str, float]:
    """Run ``episodes`` whole episodes of one seed's policy (``networks`` of a single seed).

    Returns
    -------
    ``return`` (mean, discounted as the domain reports it), ``return_se`` and ``return_sd`` (over episodes),
    ``success``, ``success_se``, ``length`` (mean counted steps); of a grounded actor also ``belief_kl``, the mean over
    steps of KL(b ‖ b̂) in nats: how far the belief it reconstructs is from the exact one.
    """
    purpose = Purpose.GREEDY_EVALUATION if greedy else Purpose.SAMPLED_EVALUATION
    streams = RandomStreams(networks.parameters.seeds, purpose, networks.parameters.device)
    batches = []
    for first in range(0, episodes, BATCH):
        episodes_here = min(BATCH, episodes - first)
        batch = _Batch(networks, domain, settings, episodes_here, streams, first * (domain.episode_limit + 1))
        batches.append(batch.run(greedy=greedy))
    returns, totals, lengths, divergences = torch.cat(batches, 1).double().cpu()
    summary = _summary(returns, totals, lengths)
    if networks.actor.grounding is not None:
        summary["belief_kl"] = (divergences.sum() / lengths.sum()).item()
    return summary


class _Batch:
    """Episodes on their way, one a lane; lanes whose episode is over are dropped now and then."""

    def __init__(
        self,
        networks: AgentNetworks,
        domain: Domain,
        settings: CommonHyperparameters,
        episodes: int,
        streams: RandomStreams,
        first_block: int,
    ) -> None:
        device = networks.parameters.device
        self.networks, self.domain, self.streams = networks, domain, streams
        self.episodes, self.first_block = episodes, first_block
        self.world = TableWorld(
            domain,
            episodes,
            device=device,
            hidden_first_action=settings.hidden_first_action,
            track_beliefs=networks.actor.kind == "belief" or networks.actor.grounding is not None,
        )
        self.world.reset(streams.block(first_block, 1, episodes, START_VARIATES)[0])
        self.hidden = torch.zeros(1, episodes, networks.hidden_width, device=device)
        self.alive = torch.ones(episodes, device=device)
        self.episode = torch.arange(episodes, device=device)  # which episode a lane holds
        # Discounted return, plain sum, length, and sum of the belief's divergences.
        self.results = torch.zeros(4, episodes, device=device)

    @torch.no_grad()
    def run(self, *, greedy: bool) -> Tensor:
        """Play to the end; returns (4, episodes): the rows of ``results``."""
        self.networks.prepare()
        for t in range(self.domain.episode_limit):
            self._step(t, greedy)
            if t % CHECK_INTERVAL == CHECK_INTERVAL - 1 and not self._drop_finished():
                break
        return self.results

    def _step(self, t: int, greedy: bool) -> None:
        drawn = self.streams.block(self.first_block + 1 + t, 1, self.episodes, 1 + STEP_VARIATES)[0]
        variates = drawn[self.episode]
        features, self.hidden = self.networks.actor_features(self.world.inputs, self.hidden)
        logits = self.networks.actor.head.forward(features)
        divergence = self._divergence(features) * self.alive
        action = logits.argmax(-1) if greedy else sample_actions(logits.softmax(-1), variates[None, :, 0])
        result = self.world.step(action[0], variates[:, 1:], self.world.inputs)
        earned = result.reward * self.alive
        discount: float = self.domain.report_discount**t
        step = torch.stack((earned * discount, earned, self.alive, divergence))
        self.results.index_add_(1, self.episode, step)
        self.alive = self.alive * ~(result.ended | result.truncated)

    def _divergence(self, features: Tensor) -> Tensor:
        """KL(b ‖ b̂) of every lane, before it acts; zero for an actor that reconstructs no belief."""
        grounding, belief = self.networks.actor.grounding, self.world.inputs.belief
        if grounding is None:
            return torch.zeros_like(self.alive)
        reconstructed = torch.log_softmax(grounding.forward(features)[0], -1)
        divergence: Tensor = -(torch.special.entr(belief) + belief * reconstructed).sum(-1)
        return divergence

    def _drop_finished(self) -> bool:
        """Go on with the unfinished episodes; False if there are none."""
        going = self.alive.nonzero()[:, 0]
        if len(going) == 0:
            return False
        if len(going) < 0.8 * len(self.alive):
            self.world.keep(going)
            self.hidden, self.episode, self.alive = (
                self.hidden[:, going],
                self.episode[going],
                self.alive[going],
            )
        return True


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
