"""Figures of the nine gaits: over speed, along ramps and in time, and of the rule of leg loading.

`gait_looks.py` has what they share.
"""

from gaitsweep.papers.fukuoka2015.figures.gait_ramp import gait_ramp as gait_ramp
from gaitsweep.papers.fukuoka2015.figures.gait_ramp import speed_gaits as speed_gaits
from gaitsweep.papers.fukuoka2015.figures.gait_series import gait_series as gait_series
from gaitsweep.papers.fukuoka2015.figures.gait_series import nine_gaits as nine_gaits
from gaitsweep.papers.fukuoka2015.figures.loading_rule import loading_rule as loading_rule
