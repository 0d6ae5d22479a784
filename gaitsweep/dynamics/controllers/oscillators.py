"""Oscillators of legs that a model file declares: phases, Hopf's or Matsuoka's, with their feedback.

Each kind is a class of `OSCILLATORS`: its fields in the file, the parameters and variables that it adds to a
model, their rates, and the pattern that it gives to each leg. A kind of your own is registered by
`OSCILLATORS.register`.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Self

import jax.numpy as jnp
from jaxtyping import Array, Float
from pydantic import Field, model_validator

from gaitsweep.dynamics import matsuoka
from gaitsweep.dynamics.declarations import TWO_PI, parameter, variable, wrapped_about_zero
from gaitsweep.schema.numbers import NotNegative, Positive, Real, Text, wrong_value
from gaitsweep.schema.strict_model import Registry, StrictModel

HIP = "hip"  # role of the joint whose angle is fed back, and which a path of the foot moves


class LegSenses(NamedTuple):
    """Senses of the legs at a state, computed where they are read.

    `loads` returns the loads (n,) on the feet, N; `hips` the angles (n,) of the hips, rad, forward positive.
    """

    loads: Callable[[], Float[Array, " legs"]]
    hips: Callable[[], Float[Array, " legs"]]


class Oscillators(StrictModel, abc.ABC):
    """Oscillators, one for each leg: a kind of a model file."""

    @property
    @abc.abstractmethod
    def resets(self) -> bool:
        """Whether a foot that lands resets its oscillator."""

    @property
    @abc.abstractmethod
    def named_legs(self) -> dict[str, list[tuple[str, ...]]]:
        """The groups of different legs that fields name, by the field."""

    @property
    @abc.abstractmethod
    def roles_of_feedback(self) -> tuple[str, ...]:
        """The roles of joints that the feedback reads, which each leg must have: hip, or none."""

    @abc.abstractmethod
    def declarations(self, legs: Sequence[str]) -> dict[str, Any]:
        """The parameters and variables of oscillators of these legs, by name."""

    @abc.abstractmethod
    def rates(
        self, legs: Sequence[str], params: Any, state: Any, senses: LegSenses
    ) -> dict[str, Float[Array, " ..."]]:
        """Time derivatives of the variables, by name."""

    @abc.abstractmethod
    def pattern(self, params: Any, state: Any) -> tuple[Float[Array, " legs"], Float[Array, " legs"]]:
        """The pattern of each leg: its place, from -1 (back) to 1 (ahead), and its lift, 0 in stance to 1."""

    @abc.abstractmethod
    def turned(self, state: Any) -> Float[Array, ""]:
        """A function that rises through zero where the first leg ends its swing: the section."""

    @abc.abstractmethod
    def period(self, params: Any) -> Float[Array, ""]:
        """The period (s) without feedback."""

    @abc.abstractmethod
    def wrapped(self, state: Any) -> Any:
        """The state just after the section."""

    @abc.abstractmethod
    def landed(self, params: Any, state: Any, leg: int) -> Any:
        """The state after the foot of a leg has landed, if `resets`."""


def _deltas(legs: Sequence[str], params: Any) -> Float[Array, " legs"]:
    """The phases (n,) of the legs in the pattern, rad."""
    return jnp.stack([getattr(params, f"delta_{leg}") for leg in legs])


class _Rhythm(Oscillators):
    """Fields of oscillators with a phase: their pattern, coupling and feedback."""

    omega: Positive = Field(description="frequency, rad/s: the parameter omega")
    phases: dict[str, Real] = Field(
        default_factory=dict,
        description="phase of each leg in the pattern, rad: the parameters delta_LEG, which are the starts; "
        "by default legs are evenly spread over a turn",
    )
    coupling: NotNegative = Field(
        default=0.0, description="strength of the coupling of all legs towards the pattern, 1/s"
    )
    sigma: Real | None = Field(
        default=None,
        description="feedback of the loads, rad/(N s): a loaded leg's phase is held near pi/2, mid-stance "
        "(Tegotae); left out: none",
    )
    reset: Real | None = Field(
        default=None,
        description="phase to which a landing foot sets its oscillator, rad: the parameter phase_landing; "
        "left out: no reset",
    )

    @property
    def resets(self) -> bool:
        return self.reset is not None

    @property
    def named_legs(self) -> dict[str, list[tuple[str, ...]]]:
        return {"phases": [(leg,) for leg in self.phases]}

    @property
    def roles_of_feedback(self) -> tuple[str, ...]:
        return ()

    def _parameters(self, legs: Sequence[str]) -> dict[str, Any]:
        """The parameters of oscillators with a phase, by name."""
        even = {leg: TWO_PI * i / len(legs) for i, leg in enumerate(legs)}
        declared: dict[str, Any] = {
            "omega": parameter("rad/s", "frequency of the oscillators", self.omega, low=0.0, open_ends=True),
            "coupling": parameter("1/s", "coupling of the oscillators towards the pattern", self.coupling),
        }
        for leg in legs:
            phase = self.phases.get(leg, even[leg])
            declared[f"delta_{leg}"] = parameter("rad", f"phase of {leg} in the pattern", phase)
        if self.sigma is not None:
            declared["sigma"] = parameter("rad/(N s)", "feedback of the loads", self.sigma)
        if self.reset is not None:
            declared["phase_landing"] = parameter("rad", "phase of a foot that lands", self.reset)
        return declared

    def _frequency(self, params: Any, ahead: Float[Array, " legs"], senses: LegSenses) -> Any:
        """The rates of the phases (n,) by the oscillators' own frequency and the loads."""
        if self.sigma is None:
            return params.omega
        return params.omega + params.sigma * senses.loads() * ahead  # slower where a stance ends

    def period(self, params: Any) -> Float[Array, ""]:
        return TWO_PI / params.omega


class PhaseOscillators(_Rhythm):
    """Phase oscillators: phi' = omega + sigma N cos(phi) + coupling sum sin(phi_j - phi - delta_j + delta).

    A leg is ahead at 0, in stance until pi, and swings until 2 pi. Loads N pull its phase towards pi/2.
    Sources: Owaki et al. 2013, J. R. Soc. Interface 10:20120669 (loads; its phases are phi + pi); Aoi and
    Tsuchiya 2005, Auton. Robots 19:219 (resets).
    """

    kind: Literal["phase"] = Field(description="phase: phase oscillators")

    def declarations(self, legs: Sequence[str]) -> dict[str, Any]:
        # the section is the next multiple of a turn that the first leg's phase meets
        first, *others = (f"delta_{leg}" for leg in legs)
        starts = (f"{first} % (2*pi)", *others)
        phase = variable("rad", "phase of leg", starts, count=len(legs), circular=True)
        return {**self._parameters(legs), "phase": phase}

    def rates(
        self, legs: Sequence[str], params: Any, state: Any, senses: LegSenses
    ) -> dict[str, Float[Array, " ..."]]:
        apart = state.phase - _deltas(legs, params)
        c, s = jnp.cos(apart), jnp.sin(apart)
        pull = params.coupling * (c * jnp.sum(s) - s * jnp.sum(c))  # the sum of sin(apart_j - apart)
        return {"phase": self._frequency(params, jnp.cos(state.phase), senses) + pull}

    def pattern(self, params: Any, state: Any) -> tuple[Float[Array, " legs"], Float[Array, " legs"]]:
        return jnp.cos(state.phase), jnp.maximum(-jnp.sin(state.phase), 0.0)

    def turned(self, state: Any) -> Float[Array, ""]:
        return state.phase[0] - TWO_PI

    def wrapped(self, state: Any) -> Any:
        return state.replace(phase=state.phase - TWO_PI)

    def landed(self, params: Any, state: Any, leg: int) -> Any:
        phase = state.phase[leg]
        return state.replace(
            phase=state.phase.at[leg].set(phase + wrapped_about_zero(params.phase_landing - phase))
        )


class HopfOscillators(_Rhythm):
    """Hopf oscillators: z' = (gain (1 - |z|^2) + i w) z + coupling sum (exp(i (delta - delta_j)) z_j - z).

    w = omega + sigma N x. The leg's place is x, its lift max(-y, 0).
    Source: Righetti and Ijspeert 2008, ICRA, p. 819.
    """

    kind: Literal["hopf"] = Field(description="hopf: Hopf oscillators")
    gain: Positive = Field(default=10.0, description="rate of the return to the limit cycle, 1/s")

    def declarations(self, legs: Sequence[str]) -> dict[str, Any]:
        n = len(legs)
        cosines = tuple(f"cos(delta_{leg})" for leg in legs)
        sines = tuple(f"sin(delta_{leg})" for leg in legs)
        return {
            **self._parameters(legs),
            "gain": parameter("1/s", "rate of the return to the limit cycle", self.gain, low=0.0),
            "hopf_x": variable("1", "x of the oscillator of leg", cosines, count=n, scale=1.0),
            "hopf_y": variable("1", "y of the oscillator of leg", sines, count=n, scale=1.0),
        }

    def rates(
        self, legs: Sequence[str], params: Any, state: Any, senses: LegSenses
    ) -> dict[str, Float[Array, " ..."]]:
        x, y = state.hopf_x, state.hopf_y
        delta = _deltas(legs, params)
        c, s = jnp.cos(delta), jnp.sin(delta)
        # the sum of exp(-i delta) z, turned by each leg's own delta
        u = jnp.sum(c * x + s * y)
        v = jnp.sum(c * y - s * x)
        n = len(legs)
        pull_x = c * u - s * v - n * x
        pull_y = s * u + c * v - n * y
        growth = params.gain * (1.0 - x * x - y * y)
        rate = self._frequency(params, x, senses)
        return {
            "hopf_x": growth * x - rate * y + params.coupling * pull_x,
            "hopf_y": growth * y + rate * x + params.coupling * pull_y,
        }

    def pattern(self, params: Any, state: Any) -> tuple[Float[Array, " legs"], Float[Array, " legs"]]:
        return state.hopf_x, jnp.maximum(-state.hopf_y, 0.0)

    def turned(self, state: Any) -> Float[Array, ""]:
        # y rises through zero where the leg is ahead, and falls where it is back
        return state.hopf_y[0]

    def wrapped(self, state: Any) -> Any:
        return state

    def landed(self, params: Any, state: Any, leg: int) -> Any:
        x, y = state.hopf_x[leg], state.hopf_y[leg]
        radius = jnp.sqrt(x * x + y * y)
        return state.replace(
            hopf_x=state.hopf_x.at[leg].set(radius * jnp.cos(params.phase_landing)),
            hopf_y=state.hopf_y.at[leg].set(radius * jnp.sin(params.phase_landing)),
        )


class MatsuokaOscillators(Oscillators):
    """Matsuoka oscillators: an extensor and a flexor a leg, with feedback of hip angle and load.

    The leg's place is the flexor's output less the extensor's, per drive, and its lift the flexor's.
    Sources: Matsuoka 1985, Biol. Cybern. 52:367; Fukuoka et al. 2015, Sci. Rep. 5:8169 (feedback).
    """

    kind: Literal["matsuoka"] = Field(description="matsuoka: Matsuoka oscillators")
    rise: Positive = Field(description="time constant of the rise, s: the parameter Tr")
    adaptation: Positive = Field(description="time constant of the adaptation, s: the parameter Ta")
    fatigue: NotNegative = Field(default=2.5, description="gain of the fatigue: the parameter b")
    mutual: Real = Field(
        default=-2.0, description="weight between a leg's extensor and flexor: the parameter gamma_"
    )
    drive: Positive = Field(default=1.0, description="tonic drive: the parameter drive")
    inhibited: list[tuple[Text, Text]] = Field(
        default_factory=list, description="pairs of legs that inhibit each other, such as [[L, R]]"
    )
    between: Real = Field(
        default=-0.5, description="weight between the legs of a pair: the parameter between"
    )
    hip: Real | None = Field(
        default=None, description="feedback of the hip's angle, 1/rad: the parameter k1; left out: none"
    )
    hip_rest: Real = Field(default=0.0, description="hip angle without feedback, rad: the parameter theta0")
    load: Real | None = Field(
        default=None, description="feedback of the load, 1/N: the parameter k2; left out: none"
    )

    @model_validator(mode="after")
    def _refuse_idle_fields(self) -> Self:
        """Refuse fields of a feedback or a coupling that there is not."""
        if "hip_rest" in self.model_fields_set and self.hip is None:
            raise wrong_value("has hip_rest, the rest of a feedback that it has not: give hip, too.")
        if "between" in self.model_fields_set and not self.inhibited:
            raise wrong_value("has between, the weight of no pair: give inhibited, too, such as [[L, R]].")
        return self

    @property
    def resets(self) -> bool:
        return False

    @property
    def named_legs(self) -> dict[str, list[tuple[str, ...]]]:
        return {"inhibited": [*self.inhibited]}

    @property
    def roles_of_feedback(self) -> tuple[str, ...]:
        return () if self.hip is None else (HIP,)

    def declarations(self, legs: Sequence[str]) -> dict[str, Any]:
        n = len(legs)
        extensors = [1.0 if is_in_stance else 0.1 for is_in_stance in self._stances(legs)]
        starts = (*extensors, *(1.1 - start for start in extensors))
        declared: dict[str, Any] = {
            "Tr": parameter("s", "time constant of the rise", self.rise, low=0.0, open_ends=True),
            "Ta": parameter("s", "time constant of the adaptation", self.adaptation, low=0.0, open_ends=True),
            "b": parameter("1", "gain of the fatigue", self.fatigue),
            "gamma_": parameter("1", "weight between extensor and flexor", self.mutual),
            "drive": parameter("1", "tonic drive", self.drive, low=0.0, open_ends=True),
            "u": variable("1", "potential of half-centre", starts, count=2 * n, scale=1.0),
            "f": variable("1", "fatigue of half-centre", 0.0, count=2 * n, scale=1.0),
        }
        if self.inhibited:
            declared["between"] = parameter("1", "weight between the legs of a pair", self.between)
        if self.hip is not None:
            declared["k1"] = parameter("1/rad", "feedback of the hips' angles", self.hip)
            declared["theta0"] = parameter("rad", "hip angle without feedback", self.hip_rest)
        if self.load is not None:
            declared["k2"] = parameter("1/N", "feedback of the loads to the flexors", self.load)
        return declared

    def _stances(self, legs: Sequence[str]) -> list[bool]:
        """Whether each leg begins in stance: of two that inhibit each other one, of others each second.

        Where legs inhibit each other in a circle of an odd number, two of them begin alike.

        The first leg begins in swing: before the section, where its extensor takes over.
        """
        stances: dict[str, bool] = {}
        for i, leg in enumerate(legs):
            stances.setdefault(leg, bool(i % 2))
            waiting = [leg]
            while waiting:
                one = waiting.pop()
                for pair in self.inhibited:
                    for other in pair if one in pair else ():
                        if other not in stances:
                            stances[other] = not stances[one]
                            waiting.append(other)
        return [stances[leg] for leg in legs]

    def rates(
        self, legs: Sequence[str], params: Any, state: Any, senses: LegSenses
    ) -> dict[str, Float[Array, " ..."]]:
        n = len(legs)
        pairs = [(legs.index(one), legs.index(other)) for one, other in self.inhibited]
        couplings = [matsuoka.Coupling(params.between, matsuoka.links(n, pairs))] if pairs else []
        u, f = matsuoka.rates(
            state.u.reshape(2, n),
            state.f.reshape(2, n),
            s=params.drive,
            Tr=params.Tr,
            Ta=params.Ta,
            b=params.b,
            gamma=params.gamma_,
            couplings=couplings,
            feedback=self._feedback(n, params, senses),
        )
        return {"u": u.reshape(-1), "f": f.reshape(-1)}

    def _feedback(self, n: int, params: Any, senses: LegSenses) -> Float[Array, "2 legs"] | float:
        """The feedback of hip angles and loads to the half-centres of n legs."""
        if self.hip is None and self.load is None:
            return 0.0
        no_hip = jnp.zeros(n), 0.0, 0.0
        hips, theta0, k1 = no_hip if self.hip is None else (senses.hips(), params.theta0, params.k1)
        loads, k2 = (jnp.zeros(n), 0.0) if self.load is None else (senses.loads(), params.k2)
        return matsuoka.leg_feedback(hips, loads, theta0=theta0, k1=k1, k2=k2)

    def pattern(self, params: Any, state: Any) -> tuple[Float[Array, " legs"], Float[Array, " legs"]]:
        extensor, flexor = jnp.split(jnp.maximum(state.u, 0.0) / params.drive, 2)
        return flexor - extensor, flexor

    def turned(self, state: Any) -> Float[Array, ""]:
        # the extensor takes over from the flexor
        return state.u[0] - state.u[state.u.shape[0] // 2]

    def wrapped(self, state: Any) -> Any:
        return state

    def landed(self, params: Any, state: Any, leg: int) -> Any:
        return state

    def period(self, params: Any) -> Float[Array, ""]:
        # the frequency of two half-centres on their limit cycle (Matsuoka 2011, Biol. Cybern. 104:297)
        share = (params.Tr + params.Ta) * params.b / (params.Tr * -params.gamma_) - 1.0
        return TWO_PI * params.Ta / jnp.sqrt(jnp.maximum(share, 0.01))


OSCILLATORS = Registry("oscillators", (PhaseOscillators, HopfOscillators, MatsuokaOscillators))
