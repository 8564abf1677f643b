from skd_adversary.pomdp.belief import ParticleBelief as ParticleBelief
from skd_adversary.pomdp.model import Pomdp as Pomdp
from skd_adversary.pomdp.model import check_model as check_model
from skd_adversary.pomdp.planner import Planner as Planner
from skd_adversary.pomdp.planner import PlannerOptions as PlannerOptions
from skd_adversary.pomdp.planner import play as play
