#pragma once

// The fits of the reflection parameters that the pixels share.

#include "malus/fusion/diffuse_fit_internal.h"
#include "malus/fusion/index_fit_internal.h"
#include "malus/fusion/reflection_sample_internal.h"
#include "malus/fusion/shading_fit_internal.h"
#include "malus/fusion/specular_fit_internal.h"
