"""Fast computation of the motion of an output that moves alone.

The reference is `gearjax.analysis.equation`, the plain path, which any solver of diffrax can integrate; tests compare
with it. From the physics to the record: `oscillator` (the equation for even steps), `fitted` (the scheme), `signals`
(the excitation), `recurrence` (the scan over steps), `march` (records).
"""
