"""Assessments: their plan, the stages that run it, the figures that follow, and files and comparisons of them."""
