"""A model in a user's hands, after it was found.

``vector_field`` has the right-hand sides as functions of numbers, with their derivatives.
"""
