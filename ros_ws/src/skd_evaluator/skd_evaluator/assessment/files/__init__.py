"""The files of an assessment: assessment.json, episodes.npz and the folder they are in; written, read and verified."""
