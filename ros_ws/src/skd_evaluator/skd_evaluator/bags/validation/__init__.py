"""Whether an episode that somebody else recorded can have happened, recomputed from its states.

`examine` looks at one log, wherever it comes from (bag, npz, live topics); `accept` at all that belong together;
`decide_again` at what the adversary of one decided.
"""

from skd_evaluator.bags.validation.acceptance import Found, accept
from skd_evaluator.bags.validation.damage import Damage
from skd_evaluator.bags.validation.decisions import Decided, Otherwise, Unverified, decide_again
from skd_evaluator.campaign.validation.verdict import Verdict, examine, is_over

__all__ = [
    "Damage", "Decided", "Found", "Otherwise", "Unverified", "Verdict", "accept", "decide_again", "examine", "is_over",
]  # fmt: skip
