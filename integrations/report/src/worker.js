// Light and nodes, away from the page's own thread: the project's WebAssembly runtime over the bytes of the file.
import { loadGdibl } from '../../web/gdibl.mjs';
import { bytesOf, floatsOfHalves } from './data.js';
import { meshOf } from './mesh.js';
import { NearestNodes } from './nearest.js';
import { luminance, quantile, UNKNOWN } from './scales.js';

// Figures that nodes have which were baked, and no others.
const OF_BAKED = [ 'noise', 'systematic', 'coverage' ];
const AXES = new Float32Array( [ 1, 0, 0, - 1, 0, 0, 0, 1, 0, 0, - 1, 0, 0, 0, 1, 0, 0, - 1 ] );
// Nodes that are read at once, so that their light needs little memory.
const PIECE = 4096;
let gdibl = null;
const volumes = [];

/** Irradiance of all nodes, mean over six normals. */
function nodesOf( volume ) {

	const count = volume.nodeCount;
	const [ positions, light, validity ] = [ new Float64Array( 3 * count ), new Float32Array( 3 * count ), new Uint8Array( count ) ];
	for ( let from = 0; from < count; from += PIECE ) {

		const to = Math.min( count, from + PIECE );
		const nodes = volume.nodes( from, to, AXES );
		positions.set( nodes.positions, 3 * from );
		validity.set( nodes.validity, from );
		for ( let k = 0; k < to - from; k ++ ) for ( let n = 0; n < 18; n ++ ) light[ 3 * ( from + k ) + n % 3 ] += nodes.irradiance[ 18 * k + n ] / 6;

	}

	return { positions, light, validity };

}

const tasks = {

	/** Parses a file. Origin: what positions are relative to from now on. */
	async open( { module, bytes, figures, seen, origin } ) {

		gdibl ??= await loadGdibl( bytesOf( module ) );
		const volume = gdibl.parse( bytesOf( bytes ) );
		const nodes = nodesOf( volume );
		const places = Float32Array.from( nodes.positions, ( x, k ) => x - origin[ k % 3 ] );
		const own = Object.fromEntries( Object.entries( figures ).map( ( [ name, text ] ) => [ name, floatsOfHalves( bytesOf( text ) ) ] ) );
		// Of nodes that were filled these are nobody's.
		for ( const name of OF_BAKED ) own[ name ]?.forEach( ( _, k ) => nodes.validity[ k ] || ( own[ name ][ k ] = UNKNOWN ) );
		const opened = { volume, ...nodes, places, origin, figures: own, nearest: new NearestNodes( places ), nearestBaked: new NearestNodes( places, nodes.validity ) };
		if ( seen.length ) {

			opened.seen = Float32Array.from( seen, ( place ) => place.error );
			opened.nearestSeen = new NearestNodes( Float32Array.from( seen.flatMap( ( place ) => place.position.map( ( x, k ) => x - origin[ k ] ) ) ) );

		}

		volumes.push( opened );
		const luminances = Float32Array.from( { length: volume.nodeCount }, ( _, k ) => luminance3( nodes.light, k ) );
		return { index: volumes.length - 1, header: volume.header, count: volume.nodeCount, figures: Object.keys( own ), luminance: quantile( luminances, 0.5 ) };

	},

	/** Places, light and figures of every so manieth node. */
	some( { index, step } ) {

		const opened = volumes[ index ];
		return pick( opened, Uint32Array.from( { length: Math.ceil( opened.volume.nodeCount / step ) }, ( _, k ) => k * step ) );

	},

	/** The level's triangles, with light between corners at most `edge` metres apart. */
	mesh( { level, edge } ) {

		const bytes = ( name ) => bytesOf( level[ name ] );
		const words = ( name, Type ) => new Type( bytes( name ).buffer );
		return meshOf( {
			positions: words( 'positions', Float32Array ),
			triangles: words( 'triangles', Uint32Array ),
			normals: Float32Array.from( words( 'normals', Int8Array ), ( n ) => n / 127 ),
			// Bytes are of square roots, so that dark colours keep their shades.
			albedo: Float32Array.from( bytes( 'albedo' ), ( byte ) => ( byte / 255 ) ** 2 ),
			emission: level.emission ? floatsOfHalves( bytes( 'emission' ) ) : null,
		}, edge );

	},

	/** For each place irradiance and a figure: that of the nearest node. x y z after x y z, relative to the origin. */
	light( { index, other, positions, normals, figure } ) {

		const opened = volumes[ index ];
		const found = irradiance( opened, positions, normals );
		const figures = figure === 'difference' ? differences( index, other, positions, normals, found ) : nearestFigures( opened, figure, positions );
		const result = new Float32Array( 4 * positions.length / 3 );
		for ( let k = 0; k < positions.length / 3; k ++ ) {

			result.set( found.subarray( 3 * k, 3 * k + 3 ), 4 * k );
			if ( figures ) result[ 4 * k + 3 ] = figures[ k ];

		}

		return result;

	},

	/** The nodes nearest to a place, at most `count`, with their irradiance at normals. */
	around( { index, place, count, normals } ) {

		const { places, volume } = volumes[ index ];
		const squares = new Float32Array( places.length / 3 );
		for ( let k = 0; k < squares.length; k ++ ) squares[ k ] = ( places[ 3 * k ] - place[ 0 ] ) ** 2 + ( places[ 3 * k + 1 ] - place[ 1 ] ) ** 2 + ( places[ 3 * k + 2 ] - place[ 2 ] ) ** 2;
		const most = squares.length <= count ? Infinity : quantile( squares, count / squares.length );
		const nodes = [];
		for ( let k = 0; k < squares.length && nodes.length < count; k ++ ) if ( squares[ k ] <= most ) nodes.push( k );
		const irradiance = new Float32Array( nodes.length * normals.length );
		nodes.forEach( ( node, k ) => irradiance.set( volume.nodes( node, node + 1, normals ).irradiance, k * normals.length ) );
		return { ...pick( volumes[ index ], nodes ), irradiance };

	},

	/** The baked node nearest to a place. */
	near( { index, place } ) {

		const { places, validity } = volumes[ index ];
		let [ best, nearest ] = [ 0, Infinity ];
		for ( let k = 0; k < validity.length; k ++ ) {

			const away = ( places[ 3 * k ] - place[ 0 ] ) ** 2 + ( places[ 3 * k + 1 ] - place[ 1 ] ) ** 2 + ( places[ 3 * k + 2 ] - place[ 2 ] ) ** 2;
			if ( validity[ k ] && away < nearest ) [ best, nearest ] = [ k, away ];

		}

		return [ ...places.slice( 3 * best, 3 * best + 3 ) ];

	},

	/** The first node whose sphere a ray meets before `far`, or -1. */
	pick( { index, from, direction, radius, far } ) {

		const { places, figures } = volumes[ index ];
		let [ best, nearest ] = [ - 1, far ];
		for ( let k = 0; k < places.length / 3; k ++ ) {

			const to = [ 0, 1, 2 ].map( ( c ) => places[ 3 * k + c ] - from[ c ] );
			const along = to[ 0 ] * direction[ 0 ] + to[ 1 ] * direction[ 1 ] + to[ 2 ] * direction[ 2 ];
			const away = to[ 0 ] ** 2 + to[ 1 ] ** 2 + to[ 2 ] ** 2 - along ** 2;
			const size = radius * ( figures.cell_size?.[ k ] ?? 1 );
			const met = along - Math.sqrt( Math.max( 0, size ** 2 - away ) );
			if ( away <= size ** 2 && met > 0 && met < nearest ) [ best, nearest ] = [ k, met ];

		}

		return best;

	},

	/** All that is known of a node, and its irradiance at normals of all directions. */
	node( { index, node, normals } ) {

		const { volume, positions, light, validity, figures } = volumes[ index ];
		const irradiance = volume.nodes( node, node + 1, normals ).irradiance;
		const own = Object.fromEntries( Object.entries( figures ).map( ( [ name, values ] ) => [ name, values[ node ] ] ) );
		return { node, position: [ ...positions.slice( 3 * node, 3 * node + 3 ) ], light: [ ...light.slice( 3 * node, 3 * node + 3 ) ], isBaked: validity[ node ] === 1, figures: own, irradiance };

	},

	/** A plane across the box: light as nodes have it, mean over six normals, and a figure. */
	slice( { index, other, axis, at, width, height, figure } ) {

		const { volume, origin } = volumes[ index ];
		const { min, max } = volume.header;
		const [ u, v ] = [ [ 2, 1 ], [ 0, 2 ], [ 0, 1 ] ][ axis ];
		const positions = new Float32Array( 3 * width * height );
		for ( let k = 0; k < width * height; k ++ ) {

			const share = [ 0, 0, 0 ];
			share[ axis ] = at;
			share[ u ] = ( k % width + 0.5 ) / width;
			// The rows of pictures go down; of a plan z does, too.
			share[ v ] = axis === 1 ? ( Math.floor( k / width ) + 0.5 ) / height : 1 - ( Math.floor( k / width ) + 0.5 ) / height;
			for ( let c = 0; c < 3; c ++ ) positions[ 3 * k + c ] = min[ c ] + share[ c ] * ( max[ c ] - min[ c ] ) - origin[ c ];

		}

		const result = new Float32Array( 4 * width * height );
		for ( let n = 0; n < 6; n ++ ) {

			const normals = Float32Array.from( positions, ( _, k ) => AXES[ 3 * n + k % 3 ] );
			const found = tasks.light( { index, other, positions, normals, figure } );
			for ( let k = 0; k < result.length; k ++ ) result[ k ] += found[ k ] / 6;

		}

		return { positions, light: result };

	},

	/** Counts of a figure, or of luminance by stops. */
	histogram( { index, figure, bins } ) {

		const { light, figures, seen, validity } = volumes[ index ];
		let values = figure === 'seen' ? seen : figures[ figure ];
		if ( figure === 'luminance' ) values = Float32Array.from( { length: light.length / 3 }, ( _, k ) => Math.log2( luminance3( light, k ) ) );
		if ( ! values ) return null;
		const counted = values.filter( ( value, k ) => Number.isFinite( value ) && ( figure === 'seen' || figure === 'validity' || validity[ k ] ) );
		const [ from, to ] = figure === 'luminance' ? [ Math.floor( quantile( counted, 0 ) ), Math.ceil( quantile( counted, 1 ) ) ] : figure === 'coverage' ? [ 0, 1 ] : figure === 'cell_size' ? [ 1, quantile( counted, 1 ) ] : [ 0, quantile( counted, 0.99 ) || 1 ];
		const counts = new Array( bins ).fill( 0 );
		for ( const value of counted ) counts[ Math.min( bins - 1, Math.max( 0, Math.floor( ( value - from ) / ( to - from || 1 ) * bins ) ) ) ] ++;
		return { from, to, counts, count: counted.length };

	},

	/** The value of a figure under which a share of nodes lies. */
	quantile( { index, figure, share } ) {

		const { figures, seen } = volumes[ index ];
		return quantile( ( figure === 'seen' ? seen : figures[ figure ] ?? new Float32Array( 0 ) ).filter( ( value ) => value !== UNKNOWN ), share );

	},

};

const luminance3 = ( rgb, k ) => luminance( [ rgb[ 3 * k ], rgb[ 3 * k + 1 ], rgb[ 3 * k + 2 ] ] );

// What is known of some nodes.
function pick( { places, light, figures }, nodes ) {

	const threes = ( values ) => Float32Array.from( { length: 3 * nodes.length }, ( _, k ) => values[ 3 * nodes[ Math.floor( k / 3 ) ] + k % 3 ] );
	const own = Object.entries( figures ).map( ( [ name, values ] ) => [ name, Float32Array.from( nodes, ( node ) => values[ node ] ) ] );
	return { places: threes( places ), light: threes( light ), figures: Object.fromEntries( own ), count: nodes.length };

}

function irradiance( { volume, origin }, positions, normals ) {

	return volume.irradianceBatch( Float32Array.from( positions, ( x, k ) => x + origin[ k % 3 ] ), normals );

}

function nearestFigures( opened, figure, positions ) {

	const own = OF_BAKED.includes( figure ) ? opened.nearestBaked : opened.nearest;
	const [ values, nearest ] = figure === 'seen' ? [ opened.seen, opened.nearestSeen ] : [ opened.figures[ figure ], own ];
	if ( ! values ) return null;
	return Float32Array.from( { length: positions.length / 3 }, ( _, k ) => values[ nearest.at( positions[ 3 * k ], positions[ 3 * k + 1 ], positions[ 3 * k + 2 ] ) ] );

}

// Root mean square over channels, over the larger of the second volume's light there and a tenth of its median: whichever of
// the two is asked.
function differences( index, other, positions, normals, found ) {

	const there = irradiance( volumes[ other ], positions, normals );
	const reference = volumes[ Math.max( index, other ) ];
	const expected = index < other ? there : found;
	reference.floor ??= 0.1 * quantile( Float32Array.from( { length: reference.volume.nodeCount }, ( _, k ) => Math.hypot( ...reference.light.subarray( 3 * k, 3 * k + 3 ) ) ), 0.5 );
	return Float32Array.from( { length: found.length / 3 }, ( _, k ) => {

		const [ a, b, e ] = [ found, there, expected ].map( ( all ) => all.subarray( 3 * k, 3 * k + 3 ) );
		return Math.hypot( a[ 0 ] - b[ 0 ], a[ 1 ] - b[ 1 ], a[ 2 ] - b[ 2 ] ) / Math.max( reference.floor, Math.hypot( ...e ), 1e-30 );

	} );

}

onmessage = async ( { data: { id, task, input } } ) => {

	try {

		const result = await tasks[ task ]( input );
		postMessage( { id, result } );

	} catch ( error ) {

		postMessage( { id, error: error.message } );

	}

};
