from skd_sim.errors import AssessmentError as AssessmentError

from skd_evaluator.assessment.assessment import Assessment as Assessment
from skd_evaluator.assessment.plan import Plan as Plan
from skd_evaluator.assessment.run.episodes import run_episode as run_episode
from skd_evaluator.library import assess as assess
from skd_evaluator.library import load_result as load_result
from skd_evaluator.metrics.clustered import clustered_mean as clustered_mean
from skd_evaluator.metrics.clustered import clustered_rate as clustered_rate
from skd_evaluator.metrics.deviation import deviation as deviation
from skd_evaluator.metrics.difference import difference as difference
from skd_evaluator.metrics.frechet import discrete_frechet as discrete_frechet
from skd_evaluator.metrics.measures import Measure as Measure
