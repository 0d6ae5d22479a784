from gaitsweep.dynamics.mjx.body import BodyState as BodyState
from gaitsweep.dynamics.mjx.body import MjxBody as MjxBody
from gaitsweep.dynamics.mjx.variants import Variants as Variants
from gaitsweep.dynamics.mjx.variants import rescale as rescale
