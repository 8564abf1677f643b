"""Reading files that others wrote, and printing names out of them safely."""
