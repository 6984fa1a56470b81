"""Simulated readings, good and faulty: is what they state believed rightly, and can hours be read?"""
