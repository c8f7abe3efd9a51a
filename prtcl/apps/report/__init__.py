"""`prtcl report`: error against run time for one scene, material by material.

`measure` tries settings on a sample of the picture's pixels, `plots` draws them, `page` puts all into one HTML file,
`command` runs them.
"""
