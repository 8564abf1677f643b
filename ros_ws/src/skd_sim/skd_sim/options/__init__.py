"""What can be chosen: options, and names, with what is known of each thing before it is made."""
