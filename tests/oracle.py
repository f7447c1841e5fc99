"""The paper's equations in plain numpy: one sample, one time step at a time, float64.

Written to be read against the text, not to be fast. Every function takes a dict of named weight arrays (a module's
``state_dict``). Scaled units throughout.
"""

import numpy as np
from numpy import tanh

Weights = dict[str, np.ndarray]


def sigma(x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-x))


def layers_of(w: Weights) -> int:
    return sum(name.startswith("input_weight.") for name in w)


def lstm_cell(w_in, w_rec, bias, peephole, u, m, c):
    """Equation LSTM: m_k and c_k of one layer from its input u_k, m_{k-1} and c_{k-1}; W^c is a diagonal or full."""
    wi_i, wi_f, wi_c, wi_o = np.split(w_in, 4)
    wm_i, wm_f, wm_c, wm_o = np.split(w_rec, 4)
    b_i, b_f, b_c, b_o = np.split(bias, 4)
    wc_i, wc_f, wc_o = (np.diag(w) if w.ndim == 1 else w for w in peephole)
    g_i = sigma(wi_i @ u + wm_i @ m + wc_i @ c + b_i)
    g_f = sigma(wi_f @ u + wm_f @ m + wc_f @ c + b_f)
    c_k = g_i * tanh(wi_c @ u + wm_c @ m + b_c) + g_f * c
    g_o = sigma(wi_o @ u + wm_o @ m + wc_o @ c_k + b_o)
    m_k = tanh(c_k) * g_o
    return m_k, c_k


def lstm_rollout(w: Weights, inputs, states, feedback=None, delays=1):
    """Free run of an LSTM; ``delays`` = 1 has single-step buffers, more is the LSTM with tapped delay lines.

    inputs (B, T, m), states (B, s) at k0, feedback (B, T, n) or None → outputs (B, T, n), states (B, s) at k0+T.
    Weights that hold an "increment_scale" (n,): the read-out, times it, is what ỹ_{k-1} changes by.
    """
    layers, n, width = layers_of(w), *w["output_weight"].shape
    samples, horizon, n_inputs = inputs.shape
    outputs, ends = np.empty((samples, horizon, n)), np.empty_like(states)
    for b in range(samples):
        x = list(states[b])
        past_u = [np.array([x.pop(0) for _ in range(n_inputs)]) for _ in range(delays - 1)]  # u_{k-1}, u_{k-2}, …
        past_y = [np.array([x.pop(0) for _ in range(n)]) for _ in range(delays)]  # ỹ_{k-1}, ỹ_{k-2}, …
        m = [np.array([x.pop(0) for _ in range(width)]) for _ in range(layers)]
        c = [np.array([x.pop(0) for _ in range(width)]) for _ in range(layers)]
        assert not x, "the state is longer than [u buffer | y buffer | m | c]"
        for k in range(horizon):
            u_k = inputs[b, k]
            layer_input = np.concatenate([u_k, *past_u, *past_y])
            for layer in range(layers):
                names = ("input_weight", "recurrent_weight", "bias", "peephole")
                m[layer], c[layer] = lstm_cell(*(w[f"{s}.{layer}"] for s in names), layer_input, m[layer], c[layer])
                layer_input = m[layer]
            y_k = w["output_weight"] @ m[-1] + w["output_bias"]
            if "increment_scale" in w:
                y_k = past_y[0] + w["increment_scale"] * y_k
            outputs[b, k] = y_k
            past_u = [u_k, *past_u][: delays - 1]
            past_y = [y_k if feedback is None else feedback[b, k], *past_y][:delays]
        ends[b] = np.concatenate([*past_u, *past_y, *m, *c])
    return outputs, ends


def mlfc_rollout(w: Weights, inputs, states, feedback=None):
    """Free run of an MLFC (equations LRLayer and layerinput, ỹ_{k-1} appended to u_k). Shapes as `lstm_rollout`.

    With a free A_o, "fed_weight", the state begins [ỹ_{k-1} | ỹ_{k-2}]: L_si wants the second one.
    """
    layers, n = layers_of(w), len(w["output_bias"])
    width = len(w["bias.0"])
    samples, horizon, _ = inputs.shape
    outputs, ends = np.empty((samples, horizon, n)), np.empty_like(states)
    for b in range(samples):
        kept = [states[b, :n], states[b, n : 2 * n]] if "fed_weight" in w else [states[b, :n]]
        start = n * len(kept)
        y = [states[b, start + i * width : start + (i + 1) * width] for i in range(layers)]
        assert states.shape[1] == start + layers * width
        for k in range(horizon):
            u_k, previous = inputs[b, k], list(y)
            for i in range(layers):
                # y^1_k .. y^{l-1}_k are this step's, y^{l+1}_{k-1} .. y^L_{k-1} the last step's
                layer_input = np.concatenate([u_k, kept[0], *y[:i], *previous[i + 1 :]])
                x = w[f"feedback_weight.{i}"] @ previous[i] + w[f"input_weight.{i}"] @ layer_input + w[f"bias.{i}"]
                y[i] = tanh(x)
            y_k = w["output_weight"] @ np.concatenate(y) + w["direct_weight"] @ u_k + w["output_bias"]
            if "fed_weight" in w:
                y_k = y_k + w["fed_weight"] @ kept[0]
            outputs[b, k] = y_k
            kept = [y_k if feedback is None else feedback[b, k], *kept][: len(kept)]
        ends[b] = np.concatenate([*kept, *y])
    return outputs, ends


def fill(inputs, outputs, delays=1):
    """Buffers (B, (delays-1) m + delays n) at the end of a history; its first sample stands for older ones."""
    rows = []
    for u, y in zip(inputs, outputs, strict=True):
        last = len(y) - 1
        past_u = [u[max(last - i, 0)] for i in range(delays - 1)]
        past_y = [y[max(last - i, 0)] for i in range(delays)]
        rows.append(np.concatenate([*past_u, *past_y]))
    return np.array(rows)


def washout(rollout, internal: int, inputs, outputs, delays=1, own=False):
    """State at k0: zero internal states at k0-τ+1, then run over k0-τ+2 .. k0 with measured outputs fed back."""
    start = np.concatenate([fill(inputs[:, :1], outputs[:, :1], delays), np.zeros((len(inputs), internal))], axis=1)
    _, end = rollout(inputs[:, 1:], start, None if own else outputs[:, 1:])
    return np.concatenate([fill(inputs, outputs, delays), end[:, end.shape[1] - internal :]], axis=1)


def bounded(x, hidden: int):
    """Hidden states are made by a tanh (a = -1, b = 1 in eq. state_init_cost); cell states are not bounded."""
    return np.concatenate([tanh(x[:hidden]), x[hidden:]])


def mlp_states(w: Weights, hidden: int, inputs, outputs):
    """[hidden | cell] at k0 from a tanh hidden layer and a linear output (eq. init_state_mapping)."""
    states = []
    for u, y in zip(inputs, outputs, strict=True):
        z = tanh(w["hidden_weight"] @ np.concatenate([*u, *y]) + w["hidden_bias"])
        states.append(bounded(w["output_weight"] @ z + w["output_bias"], hidden))
    return np.array(states)


def rnn_states(w: Weights, hidden: int, inputs, outputs):
    """[hidden | cell] at k0 from the last output of one LSTM layer over [u_k | y_k], zero states at its start."""
    states = []
    for u, y in zip(inputs, outputs, strict=True):
        m = c = np.zeros(w["recurrent_weight"].shape[1])
        for u_k, y_k in zip(u, y, strict=True):
            x_k = np.concatenate([u_k, y_k])
            m, c = lstm_cell(w["input_weight"], w["recurrent_weight"], w["bias"], w["peephole"], x_k, m, c)
        states.append(bounded(w["output_weight"] @ m + w["output_bias"], hidden))
    return np.array(states)


def lstm_state_cost(w: Weights, hidden, outputs_k0) -> float:
    """Equation state_init_cost, mean over the batch: s = [m^L | …], A_s = [W_y 0], c = y_{k0} - b_y.

    hidden (B, H) is the last layer's m at k0.
    """
    return float(
        np.mean(
            [
                np.sqrt(np.sum((w["output_weight"] @ m - (y - w["output_bias"])) ** 2))
                for m, y in zip(hidden, outputs_k0, strict=True)
            ]
        )
    )


def mlfc_state_cost(w: Weights, hidden, inputs_k0, outputs_k0, before=None) -> float:
    """Equation state_init_cost, mean over the batch: c = y_{k0} - A_o y_{k0-1} - B u_{k0} - b. hidden (B, L·H).

    ``before`` (B, n) is y_{k0-1}, needed where A_o is free.
    """
    norms = []
    for i, (s, u, y) in enumerate(zip(hidden, inputs_k0, outputs_k0, strict=True)):
        c = y - w["direct_weight"] @ u - w["output_bias"]
        if "fed_weight" in w:
            c = c - w["fed_weight"] @ before[i]
        norms.append(np.sqrt(np.sum((w["output_weight"] @ s - c) ** 2)))
    return float(np.mean(norms))


def prediction_cost(predicted, measured) -> float:
    """Equation L_pred: 1/(T D) Σ_i Σ_k e'e."""
    samples, horizon, _ = measured.shape
    total = 0.0
    for i in range(samples):
        for k in range(horizon):
            e = measured[i, k] - predicted[i, k]
            total += e @ e
    return total / (horizon * samples)
