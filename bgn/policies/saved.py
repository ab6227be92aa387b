"""What a finished run leaves to be executed: the actor's parameters with what they were trained for.

A saved history policy acts on observations and its own actions alone, as on a robot. Policies of belief
agents act on the same inputs through a belief filter, so that they can be evaluated the same way.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Self

import numpy as np
import safetensors
import safetensors.torch
import torch
from numpy.typing import NDArray
from torch import Tensor

from bgn import domains
from bgn.agents.hyperparameters import CommonHyperparameters
from bgn.agents.networks import AgentNetworks
from bgn.agents.specs import agent
from bgn.domains.domain import Domain
from bgn.errors import BgnError
from bgn.policies.belief_tracker import BeliefTracker
from bgn.simulation.table_world import Inputs

FORMAT = "bgn-policy-1"
#: Most hidden layers that a file may ask for.
MAX_LAYERS = 64


class PolicyFileError(BgnError, ValueError):
    """A file that is not a saved policy; the message says what is wrong with it."""


def save_policy(
    path: Path,
    tensors: Mapping[str, Tensor],
    *,
    domain: str,
    agent: str,
    hyperparameters: CommonHyperparameters,
    variant: Mapping[str, str | int | float | bool] | None = None,
) -> None:
    """Write the actor's parameters (:attr:`RunResult.policy`) as a safetensors file with its description."""
    description = {
        "format": FORMAT,
        "domain": domain,
        "agent": agent,
        "variant": dict(variant or {}),
        "hyperparameters": asdict(hyperparameters),
    }
    contiguous = {name: tensor.contiguous() for name, tensor in tensors.items()}
    path.write_bytes(safetensors.torch.save(contiguous, metadata={"bgn": json.dumps(description)}))


class NetworkPolicy:
    """One trained actor in one episode.

    Call :meth:`reset` at an episode's start, then :meth:`act` on every observation.

    Parameters
    ----------
    tensors
        The actor's parameters by name.
    domain, agent_id, hyperparameters
        What it was trained for.
    greedy
        Take the most probable action; otherwise sample with the generator given to :meth:`reset`.
    """

    def __init__(
        self,
        tensors: Mapping[str, Tensor],
        domain: Domain,
        agent_id: str,
        hyperparameters: CommonHyperparameters,
        *,
        greedy: bool = True,
    ) -> None:
        self.domain, self.spec, self.greedy = domain, agent(agent_id), greedy
        if self.spec.actor == "state":
            raise PolicyFileError(
                f"{agent_id} acts on the state, which no history shows; it has no policy to run"
            )
        self._networks = AgentNetworks(self.spec, domain, hyperparameters, (0,), torch.device("cpu"))
        missing = self._networks.actor_parameters() - set(tensors)
        if missing:
            raise PolicyFileError(f"the policy lacks the parameters {', '.join(sorted(missing))}")
        self._networks.parameters.load(0, tensors)
        self._networks.prepare()
        self._filter = BeliefTracker(domain) if self.spec.actor == "belief" else None
        self.reset()

    @classmethod
    def load(cls, path: Path, *, greedy: bool = True) -> Self:
        """Read what :func:`save_policy` wrote.

        Raises
        ------
        PolicyFileError
            No such file, or not a policy.
        """
        if not path.is_file():
            raise PolicyFileError(f"{path}: no such policy file")
        description = describe(path)
        try:
            tensors = safetensors.torch.load_file(path)
            domain = domains.get(description["domain"], **description["variant"])
            settings = _settings(description["hyperparameters"])
            return cls(tensors, domain, description["agent"], settings, greedy=greedy)
        except KeyError as error:
            raise PolicyFileError(f"{path}: its description says nothing of {error}") from error
        except (TypeError, ValueError, AttributeError, safetensors.SafetensorError) as error:
            raise PolicyFileError(f"{path}: {error}") from error

    def reset(self, generator: np.random.Generator | None = None) -> None:
        """Forget the last episode; ``generator`` draws the actions of a policy that samples."""
        self._generator = generator or np.random.default_rng(0)
        self._hidden = torch.zeros(1, 1, self._networks.hidden_width)
        self._features: Tensor | None = None
        self._fresh = True

    @torch.no_grad()
    def act(self, observation: int, last_action: int | None) -> int:
        """Choose the next action after ``last_action`` (None at a clean start) led to ``observation``."""
        belief, x = torch.zeros(1, 1), 0
        if self._filter is not None:
            self._filter.see(observation, last_action, fresh=self._fresh)
            belief = torch.from_numpy(self._filter.belief[None].astype(np.float32))
            x = self._filter.x
        before = self.domain.model.joint.n_actions if last_action is None else last_action
        inputs = Inputs(
            observation=torch.tensor([observation]),
            last_action=torch.tensor([before]),
            observed=torch.tensor([x]),
            state=torch.zeros(1, dtype=torch.int64),
            belief=belief,
            fresh=torch.tensor([self._fresh]),
        )
        self._fresh = False
        self._features, self._hidden = self._networks.actor_features(inputs, self._hidden)
        logits = self._networks.actor.head.forward(self._features)[0, 0]
        if self.greedy:
            return int(logits.argmax())
        probabilities = logits.softmax(-1).double().numpy()
        return int(self._generator.choice(len(probabilities), p=probabilities / probabilities.sum()))

    @torch.no_grad()
    def belief(self) -> NDArray[np.float32] | None:
        """Return the reconstructed belief b̂_Y (Y,) after the last :meth:`act`; None if not grounded."""
        grounding = self._networks.actor.grounding
        if grounding is None or self._features is None:
            return None
        reconstruction: NDArray[np.float32] = grounding.forward(self._features)[0, 0].softmax(-1).numpy()
        return reconstruction


def describe(path: Path) -> dict[str, Any]:
    """Return a saved policy's description: domain, agent, variant, hyperparameters.

    Raises
    ------
    PolicyFileError
        Not a policy file.
    """
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    except (OSError, safetensors.SafetensorError) as error:
        raise PolicyFileError(f"{path} is not a safetensors file: {error}") from error
    try:
        description = json.loads(metadata.get("bgn", "{}"))
    except (ValueError, RecursionError):  # no JSON, a number or nesting beyond all measure
        description = None
    if not isinstance(description, dict) or description.get("format") != FORMAT:
        raise PolicyFileError(f"{path} is not a policy of this project (format {FORMAT!r} expected)")
    return description


def _settings(described: Mapping[str, Any]) -> CommonHyperparameters:
    """Return what the networks need of a run's settings, whichever algorithm the rest belong to.

    Each is of its type, and of a sane size, since networks are built from them.
    """
    needed = {"shared_recurrence", "recurrent_hidden_layers"}  # without these the tensors' shapes are unknown
    if not needed <= set(described):
        raise ValueError(f"the hyperparameters lack {', '.join(sorted(needed - set(described)))}")
    known = {field.name for field in fields(CommonHyperparameters)}
    settings = CommonHyperparameters(**{name: value for name, value in described.items() if name in known})
    defaults = CommonHyperparameters()
    for name in sorted(known):
        value, kind = getattr(settings, name), type(getattr(defaults, name))
        if not (type(value) is kind or (kind is float and type(value) is int)):
            raise ValueError(f"hyperparameter {name} is {value!r}; expected a {kind.__name__}")
    if not 0 <= settings.recurrent_hidden_layers <= MAX_LAYERS:
        found = settings.recurrent_hidden_layers
        raise ValueError(f"hyperparameter recurrent_hidden_layers is {found}; expected 0 to {MAX_LAYERS}")
    return settings
