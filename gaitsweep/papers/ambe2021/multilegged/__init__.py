"""The multi-legged chain with phase resetting, and its reduced form (Ambe et al. 2021)."""

from gaitsweep.papers.ambe2021.multilegged.model import Multilegged

__all__ = ["Multilegged"]
