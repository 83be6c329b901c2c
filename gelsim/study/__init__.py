"""`gelsim study`: what would another sensor see? A grid or a Latin hypercube over any fields of a scene, and what is measured in each case.

`definition` says what a study is and reads a user's own; `trial` presses and draws a case; `metrics` is the register of what can be
measured; `runner` works through the cases, in processes, one line of results.jsonl each, so that a run that was stopped goes on; `report`
writes the table, the plot and the page. A new ready-made study is a module with a `STUDY` and a line here.
"""

STUDIES = {
    "camera": "gelsim.study.cameras",
    "coating": "gelsim.study.coatings",
    "gel-hardness": "gelsim.study.gel_hardness",
    "gel-thickness": "gelsim.study.gel_thickness",
    "light-layout": "gelsim.study.light_layout",
    "markers": "gelsim.study.marker_layouts",
}
"""Ready-made study, and the module that holds it. Names alone: nothing heavy is imported before it runs."""
