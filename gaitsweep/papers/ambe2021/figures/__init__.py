"""Figures of the multi-legged chain and its theory."""

from gaitsweep.papers.ambe2021.figures.chain_theory import chain_theory as chain_theory
from gaitsweep.papers.ambe2021.figures.drift_law import drift_law as drift_law
from gaitsweep.papers.ambe2021.figures.gait_shares import gait_shares as gait_shares
from gaitsweep.papers.ambe2021.figures.solution_set import solution_set as solution_set
from gaitsweep.papers.ambe2021.figures.wave_speed import source_place as source_place
from gaitsweep.papers.ambe2021.figures.wave_speed import wave_speed as wave_speed
