"""Extensions: each registers its commands; nothing outside imports them."""
