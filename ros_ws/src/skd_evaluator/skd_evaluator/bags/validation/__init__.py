"""Whether an episode that somebody else recorded can have happened, recomputed from its states.

`examine` looks at one log, wherever it comes from (bag, npz, live topics); `accept` at all that belong together.
"""

from skd_evaluator.bags.validation.acceptance import Found, accept
from skd_evaluator.bags.validation.damage import Damage
from skd_evaluator.campaign.validation.verdict import Verdict, examine, is_over

__all__ = ["Damage", "Found", "Verdict", "accept", "examine", "is_over"]
