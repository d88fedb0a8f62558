// Some drivers end all of a thread's loops after so many turns in total, and say nothing: what follows is wrong.

fn cut_short() -> bool {
    var n = 0u;
    for (var i = 0u; i < settings.turns; i++) {
        n += 1u;
    }
    return n != settings.turns;
}
