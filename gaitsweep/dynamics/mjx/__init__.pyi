from gaitsweep.dynamics.mjx.mjx_body import BodyState as BodyState
from gaitsweep.dynamics.mjx.mjx_body import MjxBody as MjxBody
from gaitsweep.dynamics.mjx.variants import Variants as Variants
from gaitsweep.dynamics.mjx.variants import rescale as rescale
