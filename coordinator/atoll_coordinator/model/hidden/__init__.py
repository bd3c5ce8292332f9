"""Hidden states without given equations (ADR 0112).

- `coordinates`: proposals for the course of hidden states, from the measured states alone
- `alternation`: laws for a course, and a course for the laws, in turns; the best proposal by score
"""
