"""A plan: how exact an array will be calibrated, before anything is recorded.

`request` has what is asked, `layout` reads an array, `plan` computes the bounds, `advice` what would improve them,
`trials` simulates calibrations.
"""
