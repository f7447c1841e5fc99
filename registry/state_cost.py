"""L_si, the state-initialization cost of the paper, in scaled units. Leading model dimensions are kept."""

import torch
from torch import Tensor

from registry.contracts import Gradients, Predictor
from registry.cost import batch_mean, rounded_share


def state_initialization_cost(predictor: Predictor, state: Tensor, inputs: Tensor, outputs: Tensor) -> Tensor:
    """L_si (paper, eq. state_init_cost): mean over windows of |A_s s_{k0} − c|.

    Args:
        predictor: whose read-out gives A_s s + B u + b.
        state: (…, B, s) at k0.
        inputs: (…, B, m) u_{k0}, scaled.
        outputs: (…, B, n) y_{k0}, scaled.

    Returns:
        (…): the Euclidean norm of the distance, averaged over the batch; zero for a predictor without states.
    """
    read = predictor.readout(state, inputs)
    if read is None:
        return outputs.new_zeros(outputs.shape[:-2])
    return batch_mean(torch.linalg.vector_norm(read - outputs, dim=-1))


def state_initialization_vjp(
    predictor: Predictor, state: Tensor, inputs: Tensor, outputs: Tensor, weight: float
) -> tuple[Tensor, Tensor, Gradients]:
    """`state_initialization_cost`, and the gradients of ``weight`` times it by the state and by the parameters.

    Autograd's, bit for bit.
    """
    found = predictor.readout_vjp(state, inputs)
    if found is None:
        return outputs.new_zeros(outputs.shape[:-2]), torch.zeros_like(state), {}
    read, back = found
    distance = read.sub_(outputs)
    norm = torch.linalg.vector_norm(distance, dim=-1, keepdim=True)
    cost = batch_mean(norm.squeeze(-1))
    norm.clamp_(min=torch.finfo(norm.dtype).tiny)  # a distance of zero has no direction
    d_state = torch.zeros_like(state)
    gradients = back(distance.div_(norm).mul_(rounded_share(weight, norm.shape[-2], norm.dtype)), d_state)
    return cost, d_state, gradients
