"""Robustness tests: damaged files, bad values and too little memory, given to the program as a user would."""
