"""Attacks on the program: damaged files, bad values and too little memory, each asked as a user does, and what fails counted."""
