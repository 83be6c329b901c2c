"""`gelsim bench`: what has to be shown of mechanics and light, by a command each: tables and plots, docs/validation.md.

A section is one question; its module makes the cases, measures each and says how its table reads (`section.Section`). `runner` runs the
cases of any sections, one line of results.jsonl each as soon as it is known, so that a run that was stopped goes on with --resume.
`report` writes what people read. A new section is a module with a `SECTION` and a line here.
"""

SECTIONS = {
    "accuracy": "gelsim.bench.accuracy",
    "target": "gelsim.bench.target",
    "convergence": "gelsim.bench.convergence",
    "closed-forms": "gelsim.bench.closed_forms",
    "motion": "gelsim.bench.motion",
    "unlisted": "gelsim.bench.unlisted",
    "measured-ball": "gelsim.bench.measured_ball",
    "measured-silicones": "gelsim.bench.measured_silicones",
    "speed": "gelsim.bench.speed",
    "batch": "gelsim.bench.batch",
    "stability": "gelsim.bench.stability",
    "optics": "gelsim.bench.optics",
    "end-to-end": "gelsim.bench.end_to_end",
    "live": "gelsim.bench.live",
    "live-rate": "gelsim.bench.live_rate",
    "random": "gelsim.bench.random_scenes",
}
"""Section, and the module that holds it, in the order they are run and written. Names alone: nothing heavy is imported before it runs."""
