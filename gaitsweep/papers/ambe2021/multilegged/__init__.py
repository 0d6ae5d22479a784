"""The multi-legged chain with phase resetting, and its reduced form (Ambe et al. 2021).

`model.py` is the full chain with its equations of motion (`flow`), and `reduced.py` the chain of rigid legs;
both use `parameters.py`, `state.py` (states, and coordinates on the section) and `forces.py`.
`chain_of_table.py` reads the chain of a result table.
"""

from gaitsweep.papers.ambe2021.multilegged.model import Multilegged as Multilegged
