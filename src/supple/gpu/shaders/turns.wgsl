// Some drivers end all loops of a thread after a total number of iterations, without an error.

fn cut_short() -> bool {
    var n = 0u;
    for (var i = 0u; i < settings.turns; i++) {
        n += 1u;
    }
    return n != settings.turns;
}
