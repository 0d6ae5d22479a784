from gaitsweep.dynamics import matsuoka as matsuoka
from gaitsweep.dynamics import mjx as mjx
from gaitsweep.dynamics import tree as tree
from gaitsweep.dynamics.compliant_foot import ground_force as ground_force
from gaitsweep.dynamics.declarations import TWO_PI as TWO_PI
from gaitsweep.dynamics.declarations import wrapped as wrapped
from gaitsweep.dynamics.single_precision import worked_in as worked_in
