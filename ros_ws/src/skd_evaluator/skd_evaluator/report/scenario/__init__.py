"""Scenarios as people see them: a picture, and what is said of one."""
