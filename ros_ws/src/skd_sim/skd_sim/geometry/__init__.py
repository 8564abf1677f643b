"""Places, headings, motion and contact."""
