"""Fast forms of the motion of an output that moves alone.

What they compute is what `gearjax.analysis.equation` means, the plain path, whose steps any solver of diffrax makes:
that is the reference they are tested against. From the physics to the record: `oscillator` (the equation as even steps
see it), `fitted` (the scheme), `signals` (what drives it), `recurrence` (the scan over steps), `march` (records).
"""
