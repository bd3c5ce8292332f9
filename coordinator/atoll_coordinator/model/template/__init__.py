"""What is prepared for a job with a template: given equations with parameters and unknown parts.

- `parameter_estimates`: first estimates of the parameters, from the derivatives
- `unknown_targets`: the targets of the unknown parts
"""
