"""Reading and writing what a lab has."""
