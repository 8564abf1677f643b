"""Commands that look around: at results, at how a car has changed, at what is installed."""
