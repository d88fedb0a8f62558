// Samples in the form for filtering: in linear light, if wanted, and weighted by opacity; and the inverse.

override ALPHA: bool = false;
override LIGHT: bool = false;

fn to_light(v: vec3f) -> vec3f {
    let s = v / settings.white;
    let bent_ = pow((max(s, vec3f(0.04045)) + 0.055) / 1.055, vec3f(2.4));
    return settings.white * select(bent_, s / 12.92, s <= vec3f(0.04045));
}

fn from_light(v: vec3f) -> vec3f {
    let s = v / settings.white;
    let bent_ = 1.055 * pow(max(s, vec3f(0.0031308)), vec3f(1.0 / 2.4)) - 0.055;
    return settings.white * select(bent_, s * 12.92, s <= vec3f(0.0031308));
}

// The form for filtering: linear light, if wanted, and weighted by opacity. Of two channels, the second is opacity.
fn prepared(pixel: vec4f) -> vec4f {
    var v = pixel;
    if (LIGHT) {
        v = vec4f(to_light(v.xyz), v.w);
        if (ALPHA && settings.channels < 4u) {
            v[settings.channels - 1u] = pixel[settings.channels - 1u];
        }
    }
    if (ALPHA) {
        let last = settings.channels - 1u;
        let opacity = pixel[last];
        v *= opacity / settings.white;
        v[last] = opacity;
    }
    return v;
}

fn finished(filtered: vec4f) -> vec4f {
    var v = filtered;
    if (ALPHA) {
        let last = settings.channels - 1u;
        let opacity = v[last];
        v *= select(0.0, settings.white / opacity, opacity > 0.0);
        v[last] = clamp(opacity, 0.0, settings.white); // a cubic overshoots
    }
    if (LIGHT) {
        let kept = v;
        v = vec4f(from_light(v.xyz), v.w);
        if (ALPHA && settings.channels < 4u) {
            v[settings.channels - 1u] = kept[settings.channels - 1u];
        }
    }
    return v;
}
