"""Evidence on estimates: recordings of drawn robots with their truth, and the errors of what is estimated from them.

`recordings` makes the recordings once, `replay` estimates from them again without a robot, `table` compares with the truth.
"""
