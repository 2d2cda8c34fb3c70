"""The fabrication guide: a `CompleteDesign` goes in, a Markdown page with an image of the parts after each step comes out.

`fabrication_guide.write_fabrication_guide` writes it, `assembly_steps` has the text of the steps.
"""
